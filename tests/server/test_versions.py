"""Versions that are loaded, exchanged and unloaded while a server answers."""

import json
import pickle
import shutil
import time
import weakref
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from threading import Event, Thread
from typing import TYPE_CHECKING, Any, NamedTuple, cast
from urllib.request import urlopen

import numpy as np
import pytest
from numpy.typing import NDArray
from prometheus_client.parser import text_string_to_metric_families
from typer.testing import CliRunner

import taxel
from taxel.administration import Order, give_order
from taxel.artifacts import MANIFEST
from taxel.atomic import whole_folder
from taxel.channels import CHANNELS
from taxel.commands.cli import build
from taxel.errors import InvalidArgument, NotFound, PermissionDenied, Unavailable
from taxel.lane import frames
from taxel.lane.connection import LaneConnection
from taxel.predictor import ModelInfo
from taxel.protocol import pack_infer_request, unpack_infer_response, unpackb
from taxel.remote import RemoteSource
from taxel_server.core.shadows import Shadows
from taxel_server.engine import Engine, LoadedModel, load_model
from taxel_server.loading.loader import Loader
from taxel_server.loading.trials import Trials
from taxel_server.options import Admin, ServerOptions
from taxel_server.service import Service

if TYPE_CHECKING:
    from taxel.remote.options import Transport
    from taxel_server.runtimes import Runtime

ArtifactMaker = Callable[..., Path]
WindowMaker = Callable[..., NDArray[np.float32]]

HANG_S = 900
WAIT_S = 600.0
"""Only what hangs takes so long: a process that loads gives way to all others."""


class Server(NamedTuple):
    """A server in this process, and a client of it."""

    repository: Path
    engine: Engine
    loader: Loader
    endpoint: str
    client: RemoteSource
    http: str

    def info(self, name: str, version: str) -> ModelInfo:
        unknown = ModelInfo(name, version, "", "", "", None)
        offered = self.client.models()
        return next((each for each in offered if (each.name, each.version) == (name, version)), unknown)

    def wait_for(self, holds: Callable[[], bool]) -> None:
        ends = time.monotonic() + HANG_S
        while not holds():
            assert time.monotonic() < ends
            time.sleep(0.02)


Starter = Callable[..., Server]


@pytest.fixture
def serve(repository: Path, tmp_path: Path, endpoint: str, engine: Engine) -> Iterator[Starter]:
    """`engine` has loaded the same models: nothing is compiled."""
    with ExitStack() as stack:

        def start(*, seconds: int = 60, watch: float = 0.0, admin: Admin = "loopback") -> Server:
            folder = Path(shutil.copytree(repository, tmp_path / "repository"))
            own = Engine(folder)
            loader = Loader(own, Trials(seconds, 4096), watch)
            loader.start()
            loader.wait()
            options = ServerOptions(listen=(endpoint,), admin=admin, http="127.0.0.1:0")
            service = Service(own, options, loader).start()
            stack.callback(service.close)
            client = taxel.connect(endpoint, transport="zenoh")
            stack.callback(client.close)
            return Server(folder, own, loader, endpoint, client, service.http or "")

        yield start


def counts_of(model: LoadedModel, windows: NDArray[np.float32]) -> bytes:
    return model.evaluate(windows)[:, :21].tobytes()


def ask(client: RemoteSource, path: str, windows: NDArray[np.float32]) -> bytes:
    reply = unpack_infer_response(client.get(f"taxel/v2/models/{path}/infer", pack_infer_request(windows)))
    return reply.outputs.tobytes()


def test_a_model_is_the_same_in_another_process(
    engine: Engine, make_windows: WindowMaker, repository: Path
) -> None:
    model = engine.model("skin", "10")
    copy = pickle.loads(pickle.dumps(model, protocol=5))
    handed_over = Trials(60, 4096).load(repository / "skin" / "10", engine.options)
    for rows in (1, 3, 64, 300):
        windows = make_windows(rows)
        expected = counts_of(model, windows)
        assert counts_of(copy, windows) == counts_of(handed_over, windows) == expected


def test_a_repository_that_cannot_be_read_is_one_line_of_the_log(
    serve: Starter,
    make_windows: WindowMaker,
    caplog: pytest.LogCaptureFixture,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """As when files are used up. Its models go on answering."""
    server = serve(watch=0.02)
    windows = make_windows(1)
    expected = counts_of(server.engine.model("skin", "10"), windows)

    def scan(**_: object) -> list[object]:
        raise OSError(24, "Too many open files")

    monkeypatch.setattr(server.engine, "scan", scan)
    server.wait_for(lambda: "the repository could not be read: [Errno 24]" in caplog.text)
    assert "Traceback" not in caplog.text
    assert ask(server.client, "skin/versions/10", windows) == expected


def test_a_switch_under_traffic_answers_every_request_with_one_of_the_versions(
    serve: Starter, make_artifact: ArtifactMaker, make_windows: WindowMaker
) -> None:
    server = serve()
    windows = make_windows(1)
    old = counts_of(server.engine.model("skin", "10"), windows)
    new = counts_of(load_model(make_artifact(server.repository.parent / "made", "skin", "11")), windows)
    answers: list[list[bytes]] = [[], [], []]
    stop = Event()

    def over_zenoh(into: list[bytes], path: str) -> None:
        while not stop.is_set():
            into.append(ask(server.client, path, windows))

    def over_the_lane(into: list[bytes]) -> None:
        offer = unpackb(server.client.get("taxel/v2"))["lane"]
        connection = LaneConnection(offer["address"])
        head = frames.pack_request_head("v2/models/skin/infer", 1, windows.shape, 0.0, spread=False)
        while not stop.is_set():
            connection.socket.sendall(head + windows.tobytes())
            told, content = connection.receive(WAIT_S)
            into.append(frames.read_counts(content, told)[0].tobytes() if told.rows else b"an error")
        connection.close()

    threads = [
        Thread(target=over_zenoh, args=(answers[0], "skin")),
        Thread(target=over_zenoh, args=(answers[1], "skin/versions/10")),
        Thread(target=over_the_lane, args=(answers[2],)),
    ]
    for thread in threads:
        thread.start()
    try:
        server.wait_for(lambda: all(answers))
        shutil.move(server.repository.parent / "made" / "skin" / "11", server.repository / "skin" / "11")
        assert give_order(server.client, Order("load", "skin"), WAIT_S) == "11"
        after = [len(each) + 1 for each in answers]
        server.wait_for(
            lambda: all(len(each) > start + 5 for each, start in zip(answers, after, strict=True))
        )
    finally:
        stop.set()
        for thread in threads:
            thread.join()
    followed, pinned, lane = answers
    assert set(pinned) == {old}
    for told, start in ((followed, after[0]), (lane, after[2])):
        switch = told.index(new)
        assert set(told[:switch]) == {old}
        assert set(told[switch:]) == {new}
        assert switch <= start
    # A predictor keeps the version that it was made for; a new one takes the newest.
    assert server.client.predictor("skin").manifest.version == "11"


def test_what_is_unloaded_is_gone_and_stays_so(serve: Starter, make_windows: WindowMaker) -> None:
    server = serve()
    windows = make_windows(2)
    pinned = server.client.predictor("skin", "10")
    pinned.predict(windows)
    dead = weakref.ref(server.engine.model("skin", "10").runtime)
    assert give_order(server.client, Order("unload", "skin"), WAIT_S) == "10"
    server.wait_for(lambda: dead() is None)
    with pytest.raises(Unavailable, match="version 10: it was unloaded"):
        pinned.predict(windows)
    assert server.client.predictor("skin").manifest.version == "2"
    server.loader.reload()
    server.wait_for(lambda: server.loader.is_idle)
    assert server.info("skin", "10").reason == "it was unloaded"
    with pytest.raises(NotFound, match="is not loaded"):
        give_order(server.client, Order("unload", "skin", "10"), WAIT_S)
    with pytest.raises(NotFound, match="has no version '7'"):
        give_order(server.client, Order("load", "skin", "7"), WAIT_S)
    assert give_order(server.client, Order("load", "skin", "10"), WAIT_S) == "10"
    assert pinned.predict(windows).shape == (2, 21)


def test_loading_again_leaves_nothing_and_counts_on(serve: Starter, make_windows: WindowMaker) -> None:
    server = serve()
    predictor = server.client.predictor("skin", "10")
    for count in range(2):
        predictor.predict(make_windows(1))
        dead = weakref.ref(server.engine.model("skin", "10"))
        give_order(server.client, Order("load", "skin", "10"), WAIT_S)
        server.wait_for(lambda dead=dead: dead() is None)
        stats = unpackb(server.client.get("taxel/v2/models/skin/versions/10/stats"))
        assert stats["requests"] == count + 1
    assert server.loader.counts == {"loaded": 5, "refused": 0, "unloaded": 0}


def test_a_broken_version_is_refused_and_the_old_one_serves_on(
    serve: Starter, make_artifact: ArtifactMaker, make_windows: WindowMaker
) -> None:
    server = serve()
    folder = make_artifact(server.repository, "skin", "11")
    model = folder / "model.json"
    model.write_bytes(model.read_bytes()[:-100])
    with pytest.raises(Unavailable, match="bytes, but its manifest says"):
        give_order(server.client, Order("load", "skin"), WAIT_S)
    assert server.info("skin", "11").state == "UNAVAILABLE"
    assert "damaged" in server.info("skin", "11").reason
    assert server.client.predictor("skin").manifest.version == "10"
    # A version that is served is not replaced by a damaged or another one of the same number.
    served = server.repository / "skin" / "10" / MANIFEST
    manifest = json.loads(served.read_text())
    served.write_text(json.dumps(manifest | {"description": "another"}))
    with pytest.raises(Unavailable, match="its manifest has changed"):
        give_order(server.client, Order("load", "skin", "10"), WAIT_S)
    info = server.info("skin", "10")
    assert info.state == "READY"
    assert "its manifest has changed" in info.reason
    assert server.client.predictor("skin").predict(make_windows(1)).shape == (1, 21)


def test_the_watcher_takes_a_version_once_its_folder_is_whole(
    serve: Starter, make_artifact: ArtifactMaker
) -> None:
    server = serve(watch=0.05)
    made = make_artifact(server.repository.parent / "made", "skin", "11")
    place = server.repository / "skin" / "11"
    place.mkdir()
    shutil.copy(made / MANIFEST, place)
    server.wait_for(lambda: "model.json" in server.info("skin", "11").reason)
    assert server.client.predictor("skin").manifest.version == "10"
    shutil.copy(made / "model.json", place)
    server.wait_for(lambda: server.info("skin", "11").state == "READY")
    assert server.client.predictor("skin").manifest.version == "11"
    # As `taxel loop --export` writes it: the folder appears whole.
    with whole_folder(server.repository / "skin" / "12") as folder:
        for file in made.iterdir():
            shutil.copy(file, folder)
        manifest = json.loads((folder / MANIFEST).read_text())
        (folder / MANIFEST).write_text(json.dumps(manifest | {"version": "12"}))
    server.wait_for(lambda: server.client.predictor("skin").manifest.version == "12")


def test_a_shadow_is_compared_and_answers_nobody(
    serve: Starter, make_artifact: ArtifactMaker, make_windows: WindowMaker
) -> None:
    server = serve()
    make_artifact(server.repository, "skin", "11")
    assert give_order(server.client, Order("load", "skin", "11", shadow=True), WAIT_S) == "11"
    assert server.info("skin", "11").shadow
    new, old = server.engine.model("skin", "11"), server.engine.model("skin", "10")
    shapes = (1, 1, 1, 3, 300)
    windows = [make_windows(rows, seed=seed) for seed, rows in enumerate(shapes)]
    for transport in ("lane", "zenoh"):
        with taxel.connect(server.endpoint, transport=cast("Transport", transport)) as client:
            predictor = client.predictor("skin")
            assert predictor.manifest.version == "10"
            for each in windows:
                assert predictor.predict(each).tobytes() == counts_of(old, each)
    asked = 2 * sum(shapes)

    def told() -> dict[str, Any]:
        path = "taxel/v2/models/skin/versions/11/stats"
        compared: dict[str, Any] = unpackb(server.client.get(path))["shadow"]
        return compared

    server.wait_for(lambda: sum(told()["rows"].values()) == asked)
    both = [[np.frombuffer(counts_of(model, each), np.float32) for each in windows] for model in (old, new)]
    expected = np.abs(np.concatenate(both[1]).astype(np.float64) - np.concatenate(both[0])).reshape(-1, 21)
    different = 2 * int((expected.max(axis=1) >= 1).sum())
    assert told()["of"] == "skin/10"
    assert told()["rows"] == {
        "same": asked - different,
        "different": different,
        "failed": 0,
        "skipped": 0,
    }
    assert told()["mean_difference"] == pytest.approx(expected.mean())
    assert told()["max_difference"] == pytest.approx(expected.max())
    assert told()["channel"] == CHANNELS[int(expected.sum(axis=0).argmax())]
    # Operators see it.
    text = urlopen(f"http://{server.http}/metrics", timeout=HANG_S).read().decode()
    found = {
        (sample.name, sample.labels.get("version"), sample.labels.get("result")): sample.value
        for family in text_string_to_metric_families(text)
        for sample in family.samples
    }
    assert found["taxel_shadow_rows_total", "11", "different"] == different
    assert found["taxel_shadow_max_difference_counts", "11", None] == told()["max_difference"]
    assert ("taxel_shadow_rows_total", "10", "different") not in found
    for arguments, expected_text in (
        (("top", server.endpoint, "--once", "--every", "0.1"), "skin/11, a shadow of skin/10: "),
        (("models", "--connect", server.endpoint), "skin/11 is a shadow"),
    ):
        assert expected_text in CliRunner().invoke(build(), arguments).output.replace("\n", " ")
    # It is served for good once it is loaded as such, and has a place of its own then.
    give_order(server.client, Order("load", "skin", "11"), WAIT_S)
    assert server.client.predictor("skin").manifest.version == "11"
    assert not server.info("skin", "11").shadow
    with pytest.raises(InvalidArgument, match="another version beside it"):
        give_order(server.client, Order("load", "wide", "1", shadow=True), WAIT_S)


def test_nobody_waits_for_a_shadow(engine: Engine, make_windows: WindowMaker) -> None:
    """One that never ends takes a bounded number of windows; the others are skipped."""
    asked, may_end = Event(), Event()

    class Stuck:
        def evaluate(self, windows: NDArray[np.float32]) -> NDArray[np.float32]:
            asked.set()
            may_end.wait(HANG_S)
            raise ValueError("it fails, too")

    model = engine.model("skin", "10")
    stuck = LoadedModel(model.manifest, cast("Runtime", Stuck()))
    shadows = Shadows()
    shadows.set({model: [stuck]})
    windows = make_windows(1024)
    counts = model.evaluate(windows)
    for _ in range(6):
        shadows.offer(model, windows, counts)
    assert asked.wait(HANG_S)
    compared = shadows.comparison(stuck)
    assert compared is not None
    assert compared["rows"] == {"same": 0, "different": 0, "failed": 0, "skipped": 2048}
    may_end.set()
    while (compared := shadows.comparison(stuck)) and compared["rows"]["failed"] < 4096:
        time.sleep(0.01)
    shadows.close()
    assert shadows.comparison(stuck) is None


def test_a_server_that_takes_no_orders_says_so(serve: Starter) -> None:
    server = serve(admin="off")
    with pytest.raises(PermissionDenied, match="--admin off"):
        give_order(server.client, Order("unload", "skin"), WAIT_S)
    assert server.client.predictor("skin").manifest.version == "10"


def test_orders_are_read_strictly() -> None:
    for order in (
        Order("load", "skin"),
        Order("load", "skin", "3", shadow=True),
        Order("unload", "skin", "3"),
    ):
        assert Order.read(order.path, order.payload()) == order
    for path in ("v2/repository/index", "v2/repository/models/skin", "v2/models/skin/load", "**/skin/load"):
        assert Order.read(path, b"") is None
    for wrong in (b"\xc1", b"\x01", b"\x81\xaaparameters\x81\xa6shadow\x01"):
        with pytest.raises(InvalidArgument):
            Order.read("v2/repository/models/skin/load", wrong)


def test_commands_load_and_unload(serve: Starter) -> None:
    server = serve()

    def run(*arguments: str) -> tuple[int, str]:
        result = CliRunner().invoke(build(), [*arguments, "--connect", server.endpoint])
        return result.exit_code, result.output

    assert run("unload", "skin/10") == (0, "skin/10 is unloaded\n")
    assert run("load", "skin/10") == (0, "skin/10 is served\n")
    code, told = run("load", "skin/99")
    assert (code, "has no version '99'" in told) == (1, True)
    assert run("load", "skin/x")[0] == 2
