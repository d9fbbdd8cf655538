"""Results of `bench run` for the terminal."""

from collections.abc import Sequence
from typing import Any

from rich.table import Table

from taxel_bench.figures import short

_KEYS = ("median_ms", "p90_ms", "p99_ms")


def serving_table(results: Sequence[dict[str, Any]]) -> Table:
    """One row a batch size and engine, milliseconds."""
    compared = _compared(results)
    table = Table(
        *("batch", "engine", "median", "p90", "p99", compared, "warm", compared, "verdict"),
        caption="milliseconds; the engines in turn, and warm: each back to back",
    )
    for column in table.columns[2:-1]:
        column.justify = "right"
    for result in results:
        table.add_row(
            str(result["batch"]),
            result["engine"],
            *(short(result[key]) for key in _KEYS),
            _comparison(result, "ratio", "correction_cost_cold_us"),
            short(result["warm_median_ms"]),
            _comparison(result, "warm_ratio", "correction_cost_us"),
            result["verdict"],
            end_section=result["engine"] == "taxel",
        )
    return table


def paper_table(results: Sequence[dict[str, Any]]) -> Table:
    """One row an engine, and one for the figure of a single channel that the published script printed."""
    heads = ("engine", "windows", "mean", "std", _compared(results), "verdict")
    table = Table(*heads, caption="milliseconds")
    for column in table.columns[1:-1]:
        column.justify = "right"
    for result in results:
        windows, mean, std = str(result["repetitions"]), short(result["mean_ms"]), short(result["std_ms"])
        compared = _comparison(result, "ratio", "correction_cost_cold_us")
        table.add_row(result["engine"], windows, mean, std, compared, result["verdict"])
        if "mean_ms_per_channel" in result:
            mean = short(result["mean_ms_per_channel"])
            table.add_row("paper, a channel", windows, mean, "", "", "")
    return table


def remarks(results: Sequence[dict[str, Any]], machine: dict[str, Any]) -> list[str]:
    """What has to be known beside the table, a line each."""
    first = results[0]
    lines = [
        f"{first['model']}, {first['size']} size, input combination {first['inputs']}: "
        f"{first['parameters']:,} parameters."
    ]
    engines = {result["engine"]: result for result in results}
    for name, result in engines.items():
        operations = "" if result["flops"] is None else f", {short(result['flops'] / 1e6)} MFLOP a window"
        lines.append(f"{name}: {result['how']}, threads: {result['threads']}{operations}.")
    lines += first["notes"]
    difference = first["largest_difference"]
    if difference is not None:
        lines.append(f"Both engines agree to {difference:.2g} counts." if difference else "Equal bits.")
    for result in results:
        lines += [f"batch {result['batch']}, {result['engine']}: {reason}" for reason in result["reasons"]]
    if first["size"] == "shipped":
        lines.append("A shipped model is small; --size paper measures the published size.")
    lines.append(f"On {machine['cpu']}, {machine['cores']} cores, load {machine['load']:g}.")
    return lines


def _compared(results: Sequence[dict[str, Any]]) -> str:
    """What the engines are compared by: a corrected model's effects cost time, any other gains some."""
    return "cost, µs" if any(result["engine"] == "base" for result in results) else "ratio"


def _comparison(result: dict[str, Any], ratio: str, cost: str) -> str:
    if cost in result:
        return f"{result[cost]:+,.1f}"
    return f"{short(result[ratio])}x" if ratio in result else ""
