"""The corrected test against computations that share no code with it."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import integrate
from scipy.stats import ttest_rel

from taxel.errors import InvalidArgument
from taxel_models.study.published import published_models, published_windows
from taxel_models.study.significance import compare, corrected
from taxel_models.study.summary import MODEL_PAIRS, WINDOW_PAIRS

errors = st.lists(st.floats(0.05, 2.0), min_size=3, max_size=15)


def left_tail(t: float, freedom: int) -> float:
    """Student's distribution function, by integrating its density."""
    scale = math.gamma((freedom + 1) / 2) / (math.sqrt(freedom * math.pi) * math.gamma(freedom / 2))
    area, _ = integrate.quad(lambda x: scale * (1 + x * x / freedom) ** (-(freedom + 1) / 2), 0, abs(t))
    return 0.5 - area if t < 0 else 0.5 + area


@given(errors, st.integers(0, 999), st.floats(0.05, 0.5))
def test_t_is_the_plain_paired_t_with_a_wider_variance(first: list[float], seed: int, ratio: float) -> None:
    second = np.array(first) + np.random.default_rng(seed).normal(0.02, 0.05, len(first))
    plain = ttest_rel(first, second, alternative="less").statistic
    found = compare(first, second, ratio)
    folds = len(first)
    assert found.t == pytest.approx(plain * math.sqrt((1 / folds) / (1 / folds + ratio)), rel=1e-9)
    assert found.t is not None
    assert found.p == pytest.approx(left_tail(found.t, folds - 1), abs=1e-7)


def test_an_example_by_hand() -> None:
    # d = -1, -2, -3: mean -2, variance 1; 1/3 + 1/6 = 1/2, so t = -2 / sqrt(1/2).
    found = compare([1.0, 2.0, 3.0], [2.0, 4.0, 6.0], 1 / 6)
    assert found.difference == pytest.approx(-2)
    assert found.t == pytest.approx(-2 * math.sqrt(2))
    # Two degrees of freedom have a closed form: p = 1/2 + t / (2 sqrt(2 + t^2)).
    assert found.p == pytest.approx(0.5 - 2 * math.sqrt(2) / (2 * math.sqrt(10)))
    assert found.effect == pytest.approx(-2)
    assert found.relative == pytest.approx(-0.5)
    # The 97.5 % quantile of t with two degrees of freedom is 4.302653.
    assert found.high - found.difference == pytest.approx(4.302653 * math.sqrt(0.5), rel=1e-6)
    assert found.low == pytest.approx(-2 - 4.302653 * math.sqrt(0.5), rel=1e-6)


def test_swapping_the_two_mirrors_the_outcome() -> None:
    rng = np.random.default_rng(4)
    first, second = rng.uniform(0.1, 0.3, (2, 10))
    forward, backward = compare(first, second, 0.125), compare(second, first, 0.125)
    assert forward.t == pytest.approx(-(backward.t or 0))
    assert forward.p == pytest.approx(1 - backward.p)


@pytest.mark.parametrize(("shift", "p"), [(0.0, 0.5), (0.5, 1.0), (-0.5, 0.0)])
def test_folds_that_all_differ_alike_have_no_t(shift: float, p: float) -> None:
    found = compare([1.0 + shift, 2.0 + shift, 4.0 + shift], [1.0, 2.0, 4.0], 0.1)
    assert (found.t, found.effect, found.p) == (None, None, p)


def test_holm_by_hand() -> None:
    # Differences whose p-values, sorted, are multiplied by 3, 2 and 1 and never fall.
    tests = [compare(np.array([1.0, 2.0, 3.1]) - shift, [1.0, 2.0, 3.0], 0.1) for shift in (0.3, 0.1, 0.2)]
    ordered = sorted(test.p for test in tests)
    expected = np.maximum.accumulate(np.array(ordered) * [3, 2, 1])
    assert sorted(test.p_holm for test in corrected(tests)) == pytest.approx(expected)
    assert [test.p for test in corrected(tests)] == [test.p for test in tests]
    assert corrected([]) == []


@pytest.mark.parametrize(("first", "second"), [([1.0], [2.0]), ([1.0, 2.0], [1.0]), ([], [])])
def test_what_is_not_pairs_is_refused(first: list[float], second: list[float]) -> None:
    with pytest.raises(InvalidArgument, match="expected"):
        compare(first, second, 0.1)


def test_the_published_p_values_follow_from_the_published_t() -> None:
    """Ten folds: nine degrees of freedom, left tail; printed to three decimals."""
    known = [published_models(number, f"{a} vs {b}") for number in range(1, 9) for a, b in MODEL_PAIRS]
    known += [
        published_windows(model, f"{a} vs {b}")
        for model in ("ffnn", "transformer")
        for a, b in WINDOW_PAIRS
    ]
    assert len(known) == 66
    for row in known:
        assert row is not None
        assert row["p"] == pytest.approx(left_tail(row["t"], 9), abs=6e-4)
        assert math.copysign(1, row["t"]) == math.copysign(1, row["diff_percent"])
