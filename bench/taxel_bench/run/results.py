"""Results of `bench run` for the terminal."""

from collections.abc import Mapping, Sequence
from typing import Any

from rich.table import Table

from taxel_bench.engines import BASE, TAXEL
from taxel_bench.figures import short
from taxel_bench.verdict import verdict_of

_KEYS = ("median_ms", "p90_ms", "p99_ms")


def serving_table(results: Sequence[dict[str, Any]]) -> Table:
    """One row for each batch size and engine, in milliseconds."""
    compared = _compared(results)
    table = Table(
        *("batch", "engine", "median", "p90", "p99", compared, "warm", compared, "verdict"),
        caption="milliseconds; the engines in turn, and warm: each back to back",
    )
    for column in table.columns[2:-1]:
        column.justify = "right"
    for result in results:
        ours = next(
            each for each in results if each["engine"] == TAXEL and each["batch"] == result["batch"]
        )
        table.add_row(
            str(result["batch"]),
            result["engine"],
            *(short(result[key]) for key in _KEYS),
            _comparison(result, ours, "ratio", "correction_cost_cold_us"),
            short(result["warm_median_ms"]),
            _comparison(result, ours, "warm_ratio", "correction_cost_us"),
            verdict_of(result),
            end_section=result is ours,
        )
    return table


def paper_table(results: Sequence[dict[str, Any]]) -> Table:
    """One row for each engine, and one for a single channel, which the published script printed."""
    heads = ("engine", "windows", "mean", "std", _compared(results), "verdict")
    table = Table(*heads, caption="milliseconds")
    for column in table.columns[1:-1]:
        column.justify = "right"
    for result in results:
        windows, mean, std = str(result["repetitions"]), short(result["mean_ms"]), short(result["std_ms"])
        compared = _comparison(result, results[-1], "ratio", "correction_cost_cold_us")
        table.add_row(result["engine"], windows, mean, std, compared, result["verdict"])
        if "mean_ms_per_channel" in result:
            mean = short(result["mean_ms_per_channel"])
            table.add_row("paper, a channel", windows, mean, "", "", "")
    return table


def remarks(
    results: Sequence[dict[str, Any]], skipped: Mapping[str, str], machine: dict[str, Any]
) -> list[str]:
    """Notes under the table, one line each."""
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
    lines += [line for result in engines.values() if (line := _agreement(result))]
    lines += [f"skipped {name}: {reason}" for name, reason in skipped.items()]
    for result in results:
        for name, milliseconds in result.get("too_slow", {}).items():
            took, limit = short(milliseconds), short(result["too_slow_limit_ms"])
            reason = f"a call takes {took} ms: at most {limit} are allowed"
            lines.append(f"batch {result['batch']}, {name}: not timed, {reason}")
        for name, reason in result.get("left_out", {}).items():
            lines.append(f"batch {result['batch']}, {name}: not timed, {reason}")
    for result in results:
        place = f"batch {result['batch']}, {result['engine']}"
        lines += [f"{place}: {reason}" for reason in result["reasons"]]
        lines += [f"{place}, warm: {reason}" for reason in result.get("warm_reasons", [])]
    if first["size"] == "shipped":
        lines.append("A shipped model is small; --size paper measures the published size.")
    lines.append(f"On {machine['cpu']}, {machine['cores']} cores, load {machine['load']:g}.")
    return lines


def _agreement(result: dict[str, Any]) -> str:
    """How far an engine's answers are from ours; nothing for ours, or where they are not compared."""
    difference = result["largest_difference"]
    if difference is None or result["engine"] == TAXEL:
        return ""
    rounded = ", which is what rounding its weights costs" if result["rounded"] else ""
    same = f"differs from ours by at most {difference:.2g} counts{rounded}" if difference else "equal bits"
    return f"{result['engine']}: {same}."


def _compared(results: Sequence[dict[str, Any]]) -> str:
    """The figure that compares engines: the cost of a corrected model's effects, or a speed-up."""
    return "cost, µs" if any(result["engine"] == BASE for result in results) else "ratio"


def _comparison(result: dict[str, Any], ours: dict[str, Any], ratio: str, cost: str) -> str:
    """How many times faster ours is than this engine. On our line of a corrected model: its cost."""
    if result is ours:
        return f"{result[cost]:+,.1f}" if cost in result else ""
    times = ours.get(f"{ratio}s", {}).get(result["engine"])
    return "" if times is None else f"{short(times)}x"
