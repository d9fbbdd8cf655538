"""`taxel check`: whether a control loop of a given rate can ask a running server in every step."""

import time
from typing import Annotated, Any, Final, NamedTuple

import numpy as np
import typer
from numpy.typing import NDArray
from rich.table import Table

from taxel.commands.cli import OUT, Json, print_json
from taxel.errors import DeadlineExceeded, Internal, ResourceExhausted, SettingsError
from taxel.remote import RemotePredictor, connect

_WARM_UP_S: Final = 1.0
_SHARES: Final = {"p50": 0.5, "p99": 0.99, "p99_9": 0.999, "max": 1.0}


class Steps(NamedTuple):
    """The steps of a measured loop; times in µs.

    Attributes:
        timer: how late the loop woke up, before it asked.
        round_trip: from the question to the answer.
        queue: what of it the request waited in the server.
        compute: what of it the server computed.
        late: steps without an answer before the next was due, and steps that were missed meanwhile.
        failed: those of them that got an error.
        error: the last error's text.
    """

    timer: NDArray[np.float64]
    round_trip: NDArray[np.float64]
    queue: NDArray[np.float64]
    compute: NDArray[np.float64]
    late: int
    failed: int
    error: str


def check(
    endpoint: Annotated[str, typer.Argument(help="A running server, as tcp/HOST:PORT.")],
    model: Annotated[str, typer.Option(help="Which model the loop asks.")],
    rate: Annotated[
        float, typer.Option(min=0.1, max=20_000, help="Steps of the loop in one second.")
    ] = 100.0,
    fingers: Annotated[int, typer.Option(min=1, max=4096, help="Windows in each request.")] = 1,
    seconds: Annotated[float, typer.Option(min=0.1, max=3600, help="How long to measure.")] = 5.0,
    late: Annotated[float, typer.Option(min=0, max=1, help="The share of steps that may be late.")] = 0.001,
    as_json: Json = False,
) -> None:
    """Ask a server in every step of a loop, and say whether the loop fits. Exit code 1: it does not.

    It connects, warms up for a second and measures. A step is late if its answer comes after the next step
    is due. The round trip includes this process's own Python.
    """
    total = round(rate * seconds)
    if not total:
        raise SettingsError(f"--rate {rate:g} --seconds {seconds:g}: expected at least one step")
    with connect(endpoint) as source:
        predictor = source.predictor(model)
        window = np.asarray(predictor.manifest.typical_window, np.float32)
        windows = np.tile(window, (fingers, 1))
        warm_up_ends = time.monotonic() + _WARM_UP_S
        while time.monotonic() < warm_up_ends:
            predictor.predict(windows)
        steps = run_loop(predictor, windows, rate, total)
        told = _result(predictor, steps, total, late)
    if as_json:
        print_json({"endpoint": endpoint, "rate_hz": rate, "fingers": fingers, **told})
    else:
        _print(told, 1e6 / rate)
    if not told["fits"]:
        raise typer.Exit(1)


def run_loop(predictor: RemotePredictor, windows: NDArray[np.float32], rate: float, steps: int) -> Steps:
    """Ask once in every step. A step that is due while an answer is outstanding is missed, and late.

    Args:
        predictor: that is asked.
        windows: of one step, (fingers, f).
        rate: steps in a second.
        steps: how many there are.

    Raises:
        RequestError: the server cannot be reached, or does not take the windows.
    """
    period = 1 / rate
    times: list[tuple[float, float, float, float]] = []
    late = failed = step = 0
    error = ""
    start = time.perf_counter() + period
    while step < steps:
        due = start + step * period
        if (wait := due - time.perf_counter()) > 0:
            time.sleep(wait)
        asked = time.perf_counter()
        answered_in_time = 1
        try:
            response = predictor.infer(windows)
        except (DeadlineExceeded, ResourceExhausted, Internal) as refusal:
            failed += 1
            error = str(refusal)
            answered_in_time = 0
        else:
            answered = time.perf_counter()
            queue, compute = float(response.queue_us), float(response.compute_us)
            times.append(((asked - due) * 1e6, (answered - asked) * 1e6, queue, compute))
        behind = min(int((time.perf_counter() - due) / period), steps - step)
        late += max(behind, 1 - answered_in_time)
        step += max(behind, 1)
    columns = np.array(times, np.float64).reshape(-1, 4).T
    return Steps(columns[0], columns[1], columns[2], columns[3], late, failed, error)


def _result(predictor: RemotePredictor, steps: Steps, total: int, allowed: float) -> dict[str, Any]:
    share = steps.late / total
    return {
        "model": predictor.manifest.name,
        "version": predictor.manifest.version,
        "transport": predictor.transport,
        "steps": total,
        "late": steps.late,
        "failed": steps.failed,
        "error": steps.error,
        "late_share": share,
        "allowed_share": allowed,
        "fits": share <= allowed,
        "round_trip_us": _percentiles(steps.round_trip),
        "server_queue_us": _percentiles(steps.queue),
        "server_compute_us": _percentiles(steps.compute),
        "timer_us": _percentiles(steps.timer),
    }


def _percentiles(values: NDArray[np.float64]) -> dict[str, float]:
    if not len(values):
        return {}
    return {name: round(float(np.quantile(values, share)), 1) for name, share in _SHARES.items()}


_ROWS: Final = {
    "round_trip_us": "round trip",
    "server_queue_us": "… waited in the server",
    "server_compute_us": "… computed there",
    "timer_us": "the loop woke up late by",
}


def _print(told: dict[str, Any], step_us: float) -> None:
    table = Table()
    table.add_column("µs")
    for name in _SHARES:
        table.add_column(name.replace("_", "."), justify="right")
    for field, label in _ROWS.items():
        table.add_row(label, *(f"{value:,.0f}" for value in told[field].values()))
    OUT.print(table)
    OUT.print(
        f"{told['model']}/{told['version']} over {told['transport']}: {told['steps']} steps of "
        f"{step_us:,.0f} µs, {told['late']} late, {told['failed']} of them with an error",
        markup=False,
        soft_wrap=True,
    )
    if told["error"]:
        OUT.print(f"the last error: {told['error']}", markup=False, soft_wrap=True)
    verdict = "fits" if told["fits"] else "does not fit"
    OUT.print(
        f"the loop {verdict}: {told['late_share']:.2%} of the steps were late, "
        f"at most {told['allowed_share']:.2%} may be",
        style="green" if told["fits"] else "red",
        soft_wrap=True,
    )
