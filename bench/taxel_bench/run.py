"""`bench run`: how long one model takes for windows that come one by one or in batches."""

from collections.abc import Sequence
from typing import Any, Final

from rich.table import Table

from taxel_bench.subjects import Subject, random_windows
from taxel_bench.timing import Latencies

WARM_UP: Final = 50
DISTINCT_INPUTS: Final = 256
"""Different inputs that are cycled through, so that no branch predictor learns one by heart."""


def run(subject: Subject, *, batches: Sequence[int], repetitions: int, seed: int) -> list[dict[str, Any]]:
    """Time a subject at each batch size; one result for each, as `--json` prints it."""
    return [_run_one(subject, batch, repetitions, seed) for batch in batches]


def _run_one(subject: Subject, batch: int, repetitions: int, seed: int) -> dict[str, Any]:
    distinct = max(1, DISTINCT_INPUTS // batch)
    windows = random_windows(subject.manifest, distinct * batch, seed)
    inputs = [windows[start : start + batch] for start in range(0, distinct * batch, batch)]
    latencies = Latencies.of(
        lambda number: subject.predict(inputs[number % distinct]),
        warm_up=WARM_UP,
        repetitions=repetitions,
    )
    return {
        "model": subject.model,
        "inputs": subject.manifest.window.combination,
        "size": subject.size,
        "engine": subject.engine,
        "threads": subject.threads,
        "batch": batch,
        **latencies.report(),
        "rows_per_s": batch / (latencies.median_ms / 1e3),
        "parameters": subject.manifest.parameters,
    }


def results_table(results: Sequence[dict[str, Any]]) -> Table:
    """Results for the terminal."""
    table = Table("model", "inputs", "batch", "median ms", "p90 ms", "p99 ms", "rows/s", "parameters")
    for column in table.columns[1:]:
        column.justify = "right"
    for result in results:
        table.add_row(
            result["model"],
            str(result["inputs"]),
            str(result["batch"]),
            f"{result['median_ms']:.4f}",
            f"{result['p90_ms']:.4f}",
            f"{result['p99_ms']:.4f}",
            f"{result['rows_per_s']:,.0f}",
            f"{result['parameters']:,}",
        )
    return table
