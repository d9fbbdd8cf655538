"""Faults that are no flood: mutated requests, bad clients, a full disk; with a bar for each figure."""

from collections.abc import Callable, Collection
from pathlib import Path
from typing import Any, Final

import psutil

from taxel.errors import RequestError
from taxel.manifest import Manifest
from taxel.remote import RemoteSource
from taxel_bench.chaos.bars import Bar
from taxel_bench.chaos.bystander import Bystander, bar_of_failed, bystanders
from taxel_bench.chaos.misbehaviour import FULL_DISK, lane_of, read_slowly, use_up_files, vanish
from taxel_bench.chaos.mutated import (
    Answers,
    mutated_over_lane,
    mutated_over_zenoh,
    valid_frame,
    valid_payload,
)
from taxel_bench.chaos.mutations import mutations
from taxel_bench.chaos.stopped import STOPPED, bars_of_stopped, stopped_of
from taxel_bench.server_process import running_server_process

_LOGGED: Final = 50
"""Mutated requests to a server that cannot write its log."""


def hostile_of(
    faults: Collection[str],
    endpoint: str,
    server: psutil.Process,
    model: str,
    payloads: int,
    seed: int,
    tell: Callable[[str], None],
) -> tuple[dict[str, Any], list[Bar]]:
    """The figures and bars of those faults of these that are asked for, against a live server."""
    results: dict[str, Any] = {}
    bars: list[Bar] = []
    if "mutated" in faults:
        tell("mutated requests")
        results["mutated"] = mutated_of(endpoint, model, payloads, seed)
        bars += bars_of_mutated(results["mutated"])
    if "clients" in faults:
        tell("bad clients")
        results["clients"] = misbehaviour_of(endpoint, model, server)
        bars += bars_of_misbehaviour(results["clients"])
    if "stopped" in faults:
        results["stopped"] = []
        for count in STOPPED:
            tell(f"{count} that read nothing")
            results["stopped"].append(stopped_of(endpoint, model, count))
            bars += bars_of_stopped(results["stopped"][-1])
    return results, bars


def mutated_of(endpoint: str, model: str, payloads: int, seed: int) -> dict[str, Any]:
    """Send so many mutated requests over each transport, beside clients that behave."""
    with (
        RemoteSource(endpoint, timeout=10, transport="zenoh") as source,
        bystanders(endpoint, model) as several,
    ):
        manifest = source.predictor(model).manifest
        payload, frame = valid_payload(manifest), valid_frame(manifest)
        return {
            "zenoh": _told(mutated_over_zenoh(source, manifest, mutations(payload, payloads, seed))),
            "lane": _told(
                mutated_over_lane(lane_of(source), manifest, mutations(frame, payloads, seed + 1))
            ),
            "bystanders": [each.as_dict() for each in several],
        }


def bars_of_mutated(result: dict[str, Any]) -> list[Bar]:
    """What must be true of mutated requests."""
    bars = []
    for transport in ("zenoh", "lane"):
        told = result[transport]
        for what in ("unanswered", "repeated", "untyped"):
            name = f"{told['requests']} mutated requests over {transport}: {what}"
            bars.append(Bar(name, float(told[what]), 0.0))
    return [*bars, bar_of_failed("mutated requests", result["bystanders"])]


def misbehaviour_of(endpoint: str, model: str, server: psutil.Process) -> dict[str, Any]:
    """A slow reader, vanished clients, and used-up files, beside clients that behave."""
    with (
        RemoteSource(endpoint, timeout=10, transport="zenoh") as source,
        bystanders(endpoint, model) as several,
    ):
        manifest, lane = source.predictor(model).manifest, lane_of(source)
        unread = read_slowly(lane, manifest, several)
        kept = vanish(lane, manifest, server)
        use_up_files(lane, server, several)
        told = [each.as_dict() for each in several]
    return {
        "unread_requests": unread,
        "kept_files": kept,
        "bystanders": told,
        "new_client_failed": _asks(endpoint, model),
    }


def bars_of_misbehaviour(result: dict[str, Any]) -> list[Bar]:
    """What must be true beside bad clients, and after them."""
    return [
        Bar("vanished clients: open files that are kept", float(result["kept_files"]), 0.0),
        Bar("used-up files: new clients that fail afterwards", float(result["new_client_failed"]), 0.0),
        bar_of_failed("bad clients", result["bystanders"]),
    ]


def full_disk_of(repository: Path, model: str, seed: int) -> dict[str, Any]:
    """Refused requests of a server that cannot write its log."""
    with (
        running_server_process(repository, errors=FULL_DISK) as server,
        RemoteSource(server.endpoint, timeout=10, transport="zenoh") as source,
        bystanders(server.endpoint, model) as several,
    ):
        manifest: Manifest = source.predictor(model).manifest
        payloads = mutations(valid_payload(manifest), _LOGGED, seed)
        answers = mutated_over_zenoh(source, manifest, payloads)
    return {**_told(answers), "bystanders": [each.as_dict() for each in several]}


def bars_of_full_disk(result: dict[str, Any]) -> list[Bar]:
    """What must be true of a server whose log goes to a full disk."""
    return [
        Bar("full disk: unanswered requests", float(result["unanswered"]), 0.0),
        bar_of_failed("full disk", result["bystanders"]),
    ]


def _asks(endpoint: str, model: str) -> int:
    """How many new clients fail: of one over each transport."""
    failed = 0
    for transport in ("lane", "zenoh"):
        try:
            with RemoteSource(endpoint, timeout=10, transport=transport) as source:
                bystander = Bystander(source.predictor(model))
                bystander.ask()
                failed += bystander.failed
        except RequestError:
            failed += 1
    return failed


def _told(answers: Answers) -> dict[str, Any]:
    return {**vars(answers), "errors": dict(answers.errors)}
