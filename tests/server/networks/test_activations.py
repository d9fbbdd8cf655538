"""Activations against SciPy's in float64."""

from collections.abc import Callable

import numba
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import special

from taxel_server.runtimes.networks import activations

Array = np.ndarray


def compiled(function: Callable[..., np.float32]) -> Callable[[Array], Array]:
    """A function of each value, in a loop that LLVM may turn into vectors."""
    alpha, beta = np.float32(0.7), np.float32(0)

    @numba.njit
    def apply(values: Array) -> Array:
        result = np.empty_like(values)
        for place in range(values.size):
            result[place] = function(values[place], alpha, beta)
        return result

    return apply  # type: ignore[no-any-return]


@numba.njit
def exponential(x: np.float32, _alpha: np.float32, _beta: np.float32) -> np.float32:
    return activations.exponential(x)


# Largest errors: in units in the last place of the result, and as a share of the value.
CASES = {
    "exponential": (exponential, np.exp, 2, 0),
    "tanh": (activations.tanh, np.tanh, 3, 0),
    "sigmoid": (activations.sigmoid, special.expit, 4, 0),
    "gelu": (activations.gelu, lambda x: x * special.ndtr(x), 4, 1.5e-7),
    "elu": (activations.elu, lambda x: np.where(x > 0, x, 0.7 * np.expm1(x)), 2, 0),
}
APPLY = {name: compiled(case[0]) for name, case in CASES.items()}


def check(name: str, values: Array) -> None:
    _, exact, units, share = CASES[name]
    expected = exact(values.astype(np.float64))
    # Below one, e**x - 1 has the error of e**x.
    unit = np.spacing(np.maximum(np.abs(expected), 0.7 if name == "elu" else 0).astype(np.float32))
    error = np.abs(APPLY[name](values) - expected)
    np.testing.assert_array_less(error, units * unit.astype(np.float64) + share * np.abs(values) + 1e-37)


@pytest.mark.parametrize("name", CASES)
def test_the_whole_range_is_within_its_bound(name: str) -> None:
    near = np.linspace(-10, 10, 400_001, dtype=np.float32)
    far = np.linspace(-86, 86, 100_001, dtype=np.float32)
    small = np.geomspace(1e-30, 1, 10_001, dtype=np.float32)
    for values in (near, far, small, -small, np.zeros(3, np.float32)):
        check(name, values)


@pytest.mark.parametrize("name", CASES)
@given(st.lists(st.floats(-86, 86, width=32), min_size=1, max_size=70))
@settings(max_examples=100, deadline=None)
def test_any_number_of_values(name: str, values: list[float]) -> None:
    check(name, np.array(values, np.float32))


@pytest.mark.parametrize(
    ("name", "lowest", "highest"),
    [("exponential", 0, 1e38), ("tanh", -1, 1), ("sigmoid", 0, 1), ("gelu", 0, 3e38), ("elu", -0.7, 3e38)],
)
def test_beyond_the_range_they_stay_finite(name: str, lowest: float, highest: float) -> None:
    low, high = APPLY[name](np.array([-3e38, 3e38], np.float32))
    assert low == pytest.approx(lowest, abs=1e-30)
    assert high == pytest.approx(highest, rel=0.7)
