"""How our result compares with those of the other engines that were timed in turn with it."""

from collections.abc import Sequence
from typing import Any

from taxel_bench.engines import BASE, PUBLISHED, TAXEL

Result = dict[str, Any]


def compare_engines(results: Sequence[Result]) -> None:
    """Add to our result how it compares with the results beside it, of one batch size.

    For a corrected model, this is the cost of its effects. For any other model, it is how many times faster
    ours is: `ratio` than the published way, `ratios` than each engine by its name. `best_peer` names the
    fastest whose answers were compared.
    """
    engines = {result["engine"]: result for result in results}
    ours = engines[TAXEL]
    cold = "mean_ms" if "mean_ms" in ours else "median_ms"
    figures = {"ratio": cold, "cpu_ratio": "cpu_median_ms"}
    if "warm_median_ms" in ours:
        figures["warm_ratio"] = "warm_median_ms"
    if cold == "mean_ms":
        del figures["cpu_ratio"]
    for ratio, figure in figures.items():
        if others := others_of(results):
            ours[f"{ratio}s"] = {name: other[figure] / ours[figure] for name, other in others.items()}
        if PUBLISHED in others:
            ours[ratio] = ours[f"{ratio}s"][PUBLISHED]
    for name, figure in (("best_peer", cold), ("best_warm_peer", "warm_median_ms")):
        if figure in ours and (best := fastest(results, figure)):
            ours[name] = best["engine"]
    if BASE in engines:
        base = engines[BASE]
        ours["correction_cost_cold_us"] = (ours[cold] - base[cold]) * 1e3
        if "warm_median_ms" in ours:
            ours["correction_cost_us"] = (ours["warm_median_ms"] - base["warm_median_ms"]) * 1e3


def others_of(results: Sequence[Result]) -> dict[str, Result]:
    """Results of the published way and of other libraries, by the engine's name."""
    return {result["engine"]: result for result in results if result["engine"] not in (TAXEL, BASE)}


def fastest(results: Sequence[Result], figure: str) -> Result | None:
    """The fastest of the others whose answers are known to be ours; None where there is none."""
    same_answers = [
        result
        for result in others_of(results).values()
        if result["largest_difference"] is not None and not result.get("rounded", False)
    ]
    return min(same_answers, key=lambda result: float(result[figure]), default=None)
