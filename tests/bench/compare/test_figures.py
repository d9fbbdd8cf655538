"""Medians and ratios: of each figure, and of the same round."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from taxel_bench.compare.figures import Figures, Gap, median_ratios

positive = st.floats(1e-3, 1e6)
gaps = st.fixed_dictionaries({"10": st.builds(Gap, positive, positive, positive)})
figures = st.builds(Figures, *[positive] * 6, gaps)


def test_a_ratio_is_ours_over_theirs() -> None:
    ratios = Figures(1, 20, 3000, 10, 5, 6).over(Figures(2, 10, 1000, 40, 5, 2))
    assert ratios == {
        "sequential_p50_ms": 0.5,
        "sequential_cpu_us": 2,
        "in_flight_per_s": 3,
        "in_flight_cpu_us": 0.25,
        "bulk_p50_ms": 1,
        "batch_p50_ms": 3,
        "gaps": {},
    }


def test_ratios_are_taken_within_a_round() -> None:
    """A machine that slows down for whole rounds changes medians, but not ratios."""
    ours = [Figures(1 * slow, 1, 1, 1, 1, 1) for slow in (1, 10, 3)]
    theirs = [Figures(2 * slow, 1, 1, 1, 1, 1) for slow in (1, 10, 3)]
    assert median_ratios(ours, theirs)["sequential_p50_ms"] == 0.5
    assert Figures.median(ours).sequential_p50_ms == 3


@given(st.lists(figures, min_size=1, max_size=9))
def test_ratios_to_itself_are_one(rounds: list[Figures]) -> None:
    ratios = median_ratios(rounds, rounds)
    ratios.update(ratios.pop("gaps")["10"])
    assert all(ratio == pytest.approx(1) for ratio in ratios.values())
