"""`taxel demo`: the main job from end to end, on what Taxel ships."""

import signal
import sys
from typing import Annotated, Any

import typer
from rich.progress import Progress
from rich.table import Table

from taxel.commands.cli import ERR, OUT, Json, needs, print_json
from taxel.dependencies import SERVING

_SEED = 2024
"""Of the replayed recording; the shipped models were trained on other seeds."""

_WARMED_UP = 60_000
"""Where the replay begins, in samples: a cold finger differs from most of what a model has seen."""


@needs("server", *SERVING)
def demo(
    model: Annotated[str, typer.Option(help="Which shipped model to serve.")] = "xgb",
    seconds: Annotated[float, typer.Option(min=1.0, help="How long to replay at 100 Hz.")] = 10.0,
    rows: Annotated[int, typer.Option(min=100, help="Samples to replay flat out.")] = 6000,
    as_json: Json = False,
) -> None:
    """Serve a shipped model and replay a recording through it as a simulator would."""
    import taxel
    from taxel_bench.demo.replay import replay
    from taxel_bench.server_process import running_server
    from taxel_models.evaluation.error_table import error_table
    from taxel_models.evaluation.metrics import ErrorMetrics
    from taxel_models.shipped import shipped_repository
    from taxel_models.twin import simulate

    # Told to stop, it still stops its server.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))
    paced_rows = round(seconds * 100)
    ERR.print("starting a server; the first start on a machine takes about half a minute")
    recording = simulate(_WARMED_UP + max(rows, paced_rows), _SEED).rows(slice(_WARMED_UP, None))
    with (
        running_server(shipped_repository()) as endpoint,
        taxel.connect(endpoint) as server,
        Progress(console=ERR, disable=not ERR.is_terminal) as progress,
    ):
        predictor = server.predictor(model)
        bar = progress.add_task("replaying at 100 Hz", total=paced_rows)
        paced = replay(
            recording.rows(slice(paced_rows)),
            predictor,
            paced=True,
            watch=lambda done: progress.update(bar, completed=done),
        )
        bar = progress.add_task("replaying flat out", total=rows)
        flat_out = replay(
            recording.rows(slice(rows)),
            predictor,
            paced=False,
            watch=lambda done: progress.update(bar, completed=done),
        )
    manifest = predictor.manifest
    errors = ErrorMetrics.of(flat_out.measured, flat_out.predicted, manifest.normalisation.output_std)
    runs = {"100 Hz": paced, "flat out": flat_out}
    if as_json:
        timings = {name: {**run.latencies.report(), "late": run.late} for name, run in runs.items()}
        print_json({"model": manifest.label, "latency": timings, **errors.report()})
        return
    OUT.print(f"[bold]Predicted against measured[/], {manifest.name} version {manifest.version}:")
    OUT.print(error_table(errors))
    OUT.print(_latency_table(runs))
    _say_where_next(predictor.window.delay_s)


def _latency_table(runs: dict[str, Any]) -> Table:
    table = Table("replay", "windows", "median, ms", "p90, ms", "p99, ms", "over 10 ms", "windows/s")
    for column in table.columns[1:]:
        column.justify = "right"
    for name, run in runs.items():
        figures = run.latencies.report()
        table.add_row(
            name,
            str(figures["repetitions"]),
            *(f"{figures[key]:.3f}" for key in ("median_ms", "p90_ms", "p99_ms")),
            str(run.late),
            f"{len(run.predicted) / run.seconds:,.0f}",
        )
    return table


def _say_where_next(delay_s: float) -> None:
    OUT.print("Each latency is a sample pushed, its window built, sent to the server process and answered.")
    if delay_s:
        OUT.print(f"This model looks {delay_s * 1e3:g} ms ahead: a sample's window is whole only then.")
    OUT.print(
        "The recording is simulated. Where next:\n"
        "  taxel serve                             a server of these models\n"
        "  taxel models                            what it serves\n"
        "  taxel twin -o twin.csv                  a simulated recording, as yours would be written\n"
        "  taxel predict twin.csv --model xgb --connect tcp/127.0.0.1:7447 -o predicted.csv\n"
        "With pip install 'taxel[train]':\n"
        "  taxel train --data twin.csv -o trained  a model of your own\n"
        "With pip install 'taxel[bench]':\n"
        "  taxel bench run --model xgb             the bare model's latency",
        markup=False,
        soft_wrap=True,
    )
