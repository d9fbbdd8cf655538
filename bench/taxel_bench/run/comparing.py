"""How our result compares with those of the other engines that were timed in turn with it."""

from collections.abc import Sequence
from typing import Any

from taxel_bench.engines import BASE, PUBLISHED, TAXEL

Result = dict[str, Any]


def compare_engines(results: Sequence[Result]) -> None:
    """Add to our result how it compares with the results beside it, of one batch size.

    For a corrected model, this is the cost of its effects. For any other model, it is how many times faster
    ours is. Each peer has a ratio, and `best_peer` names the fastest.
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
        if PUBLISHED in engines:
            ours[ratio] = engines[PUBLISHED][figure] / ours[figure]
        if peers := peers_of(results):
            ours[f"{ratio}s"] = {peer["engine"]: peer[figure] / ours[figure] for peer in peers}
    for name, figure in (("best_peer", cold), ("best_warm_peer", "warm_median_ms")):
        if figure in ours and (best := fastest(results, figure)):
            ours[name] = best["engine"]
    if BASE in engines:
        base = engines[BASE]
        ours["correction_cost_cold_us"] = (ours[cold] - base[cold]) * 1e3
        if "warm_median_ms" in ours:
            ours["correction_cost_us"] = (ours["warm_median_ms"] - base["warm_median_ms"]) * 1e3


def peers_of(results: Sequence[Result]) -> list[Result]:
    """Results of other libraries, without the published way and ours."""
    return [result for result in results if result["engine"] not in (TAXEL, PUBLISHED, BASE)]


def fastest(results: Sequence[Result], figure: str) -> Result | None:
    """The fastest of the others that give the same answers, the published way among them; None alone."""
    others = [
        result
        for result in results
        if result["engine"] not in (TAXEL, BASE) and not result.get("rounded", False)
    ]
    return min(others, key=lambda result: float(result[figure]), default=None)
