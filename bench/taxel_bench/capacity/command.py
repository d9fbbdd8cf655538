"""`bench capacity`: how many fingers one server carries with p99 below one step."""

import multiprocessing
import signal
import sys
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from taxel.commands.cli import OUT, Json, needs, print_json
from taxel.commands.progress import shown
from taxel.dependencies import SERVING
from taxel.remote.options import Transport
from taxel_bench.options import parse_names, parse_numbers

if TYPE_CHECKING:
    from taxel_bench.capacity.search import Generator

MODELS: Final = "xgb,ffnn,transformer,network-a,network-b"
TRANSPORTS: Final[tuple[Transport, ...]] = ("lane", "zenoh")


@needs("bench", *SERVING, "psutil")
def capacity(
    models: Annotated[str, typer.Option(help="Served models, with commas between.")] = MODELS,
    rates: Annotated[str, typer.Option(help="Steps a second, with commas between.")] = "100,1000",
    transports: Annotated[str, typer.Option(help="How clients ask, with commas between.")] = "lane,zenoh",
    clients: Annotated[int, typer.Option(min=1, max=64, help="Processes that share the fingers.")] = 2,
    seconds: Annotated[float, typer.Option(min=0.1, help="Least time of an attempt.")] = 2.0,
    most: Annotated[int, typer.Option(min=1, max=65_536, help="Fingers that are tried at most.")] = 16_384,
    repository: Annotated[
        Path | None, typer.Option(help="What the server serves; the shipped models if not set.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Search for the most fingers that one server carries with p99 below one step of their loop.

    Each client asks for its part of the fingers in one request a step, as `predictor.fingers` does.
    """
    from taxel_bench.capacity.printing import capacity_table, service_table
    from taxel_bench.capacity.search import find_capacity, result_of
    from taxel_bench.capacity.service_time import measure_service_time
    from taxel_bench.machine import describe_machine
    from taxel_models.shipped import shipped_repository

    served = repository or shipped_repository()
    names = parse_names("--models", models, (each.name for each in served.iterdir()), "model")
    ways = [
        each
        for each in TRANSPORTS
        if each in parse_names("--transports", transports, TRANSPORTS, "transport")
    ]
    steps = parse_numbers("--rates", rates, range(1, 20_001), "1 to 20000")
    # Told to stop, it still stops its server and clients.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))
    machine = describe_machine()
    results: list[dict[str, Any]] = []
    services: list[dict[str, Any]] = []
    with shown("starting the server") as tell, generator(served, clients, seconds) as asking:
        for model in names:
            for transport in ways:
                tell(f"{model} over {transport}: service time")
                service = measure_service_time(asking, model, transport, seconds)
                services.append({"model": model, "transport": transport, **service._asdict()})
                for rate in steps:
                    tell(f"{model} over {transport} at {rate} Hz")
                    attempt = partial(asking.try_fingers, model, transport, rate)
                    fingers, attempts = find_capacity(attempt, most)
                    results.append(result_of(model, transport, rate, fingers, attempts, most))
    if as_json:
        told = {"machine": machine, "clients": clients, "seconds": seconds, "service": services}
        print_json({**told, "results": results})
        return
    OUT.print(capacity_table(results))
    for result in results:
        for reason in result["reasons"]:
            told_of = f"{result['model']} over {result['transport']} at {result['rate_hz']:g} Hz"
            OUT.print(f"{told_of}: {reason}", markup=False, soft_wrap=True)
    OUT.print(service_table(services))
    OUT.print(f"on {machine['cpu']}, {machine['cores']} cores, load {machine['load']}", soft_wrap=True)


@contextmanager
def generator(repository: Path, clients: int, seconds: float) -> "Iterator[Generator]":
    """A server of its own, and client processes."""
    from taxel_bench.capacity.search import Generator
    from taxel_bench.server_process import running_server_process

    context = multiprocessing.get_context("spawn")
    with (
        running_server_process(repository) as server,
        ProcessPoolExecutor(clients, context) as pool,
    ):
        # A process starts with its first task; the first attempt must not wait for that.
        list(pool.map(abs, range(4 * clients)))
        yield Generator(pool, server, clients, seconds)
