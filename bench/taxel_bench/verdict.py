"""Whether a measurement supports the percentile that it prints: VALID or INVALID, and why."""

from collections.abc import Sequence
from typing import Any, Final

CONFIDENCE: Final = 0.99


def queries_for(percentile: float) -> int:
    """Queries that a percentile needs before it may be printed.

    As many as are needed that, were the true share below the printed latency any smaller, at most one
    query above it would be seen with a probability of at most 1 %: the least n with
    p^n + n (1 - p) p^(n - 1) <= 0.01. MLPerf's early stopping asks for as many: 64 for p90, 662 for p99.
    """
    share = percentile / 100
    queries = 1
    while share**queries + queries * (1 - share) * share ** (queries - 1) > 1 - CONFIDENCE:
        queries += 1
    return queries


def verdict(reasons: Sequence[str]) -> dict[str, Any]:
    """`VALID` where nothing speaks against a measurement, else `INVALID` with the reasons."""
    return {"verdict": "INVALID" if reasons else "VALID", "reasons": list(reasons)}


def too_few(queries: int, percentile: float) -> list[str]:
    """The reason why so few queries do not support a percentile; none where they do."""
    needed = queries_for(percentile)
    if queries >= needed:
        return []
    return [f"{queries} queries do not support p{percentile:g}: at least {needed} are needed"]


def verdict_of(*results: dict[str, Any]) -> str:
    """Of all figures of some results, in turn and warm."""
    verdicts = {result[key] for result in results for key in ("verdict", "warm_verdict")}
    return "VALID" if verdicts == {"VALID"} else "INVALID"
