"""Dense layers in panels against NumPy in float64."""

import numba
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from taxel_server.runtimes.networks.panels import EXACT, LANES, MOST_ROWS, ROUNDED, Panels, arrange, dense


@numba.njit
def call(values, rows, terms, columns, bits, panels, scale, bias, result, spare):  # type: ignore[no-untyped-def]
    dense(values, rows, terms, columns, bits, panels, scale, bias, result, spare)


def evaluate(values: np.ndarray, panels: Panels, columns: int, bias: np.ndarray) -> np.ndarray:
    rows, terms = values.shape
    padded = np.zeros(len(panels.scale), np.float32)
    padded[:columns] = bias
    # What is written beyond the result would show.
    result = np.full(rows * columns + LANES, np.nan, np.float32)
    spare = np.zeros(MOST_ROWS * LANES, np.float32)
    call(
        *(values.ctypes.data, rows, terms, columns, panels.bits, panels.content.ctypes.data),
        *(panels.scale.ctypes.data, padded.ctypes.data, result.ctypes.data, spare.ctypes.data),
    )
    assert np.isnan(result[rows * columns :]).all()
    return result[: rows * columns].reshape(rows, columns)


@given(
    rows=st.integers(1, 20),
    terms=st.integers(1, 40),
    columns=st.integers(1, 3 * LANES),
    rounded=st.booleans(),
    seed=st.integers(0, 2**32 - 1),
)
@settings(max_examples=200, deadline=None)
def test_a_layer_is_as_exact_as_float32_allows(
    rows: int, terms: int, columns: int, rounded: bool, seed: int
) -> None:
    generator = np.random.default_rng(seed)
    values = generator.normal(size=(rows, terms)).astype(np.float32)
    weights = (generator.normal(size=(terms, columns)) * generator.uniform(0, 10, columns)).astype(
        np.float32
    )
    bias = generator.normal(size=columns).astype(np.float32)
    panels = arrange(weights, rounded)
    assert panels.bits == (ROUNDED if rounded else EXACT)
    expected = values.astype(np.float64) @ weights + bias
    # A sum's rounding errors, and half a step of each weight.
    parts = np.abs(values).astype(np.float64) @ np.abs(weights) + np.abs(bias)
    steps = np.abs(values).astype(np.float64).sum(axis=1)[:, None] * np.abs(weights).max(axis=0) * 2.0**-23
    bound = (terms + 2) * 2.0**-24 * parts + rounded * steps
    np.testing.assert_array_less(np.abs(evaluate(values, panels, columns, bias) - expected), bound + 1e-30)


def test_rounded_weights_cost_a_sum_no_more_than_float32_does() -> None:
    generator = np.random.default_rng(0)
    terms, columns = 1000, 500
    values = generator.normal(size=(1, terms)).astype(np.float32)
    weights = generator.uniform(-1, 1, size=(terms, columns)).astype(np.float32) / np.float32(terms**0.5)
    exact = values.astype(np.float64) @ weights
    nothing = np.zeros(columns, np.float32)
    rounded, whole = (
        np.abs(evaluate(values, arrange(weights, chosen), columns, nothing) - exact).max()
        for chosen in (True, False)
    )
    assert rounded < 1.5 * whole


@pytest.mark.parametrize("bits", [ROUNDED, EXACT])
def test_columns_of_nothing_and_of_one_size(bits: int) -> None:
    weights = np.zeros((3, 5), np.float32)
    weights[:, 1:] = [1, -1, 0.5, 2.0**-30]
    panels = arrange(weights, bits == ROUNDED)
    assert panels.bits == bits
    result = evaluate(np.ones((1, 3), np.float32), panels, 5, np.zeros(5, np.float32))
    np.testing.assert_allclose(result, 3 * weights[:1], rtol=2.0**-22)


def test_a_column_with_one_large_weight_keeps_float32() -> None:
    weights = np.full((10_000, 2), 1e-3, np.float32)
    assert arrange(weights, rounded=True).bits == ROUNDED
    weights[17, 1] = 10
    assert arrange(weights, rounded=True).bits == EXACT
