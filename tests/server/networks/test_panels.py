"""Dense layers in panels against NumPy in float64."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from taxel_server.runtimes.networks.panels import LANES, panels_of
from taxel_server.runtimes.networks.program import Operation, ProgramBuilder
from taxel_server.runtimes.networks.runtime import ProgramEvaluator


def evaluate(values: np.ndarray, weights: np.ndarray, bias: np.ndarray) -> np.ndarray:
    """A layer as a program of one step: one row with weights of 24 bits, more with float32."""
    (rows, terms), columns = values.shape, weights.shape[1]
    builder = ProgramBuilder()
    window, result = builder.allocate(rows, terms), builder.allocate(rows, columns)
    start = builder.weights(panels_of(weights, bias, exact=rows > 1))
    builder.add(Operation.DENSE, result, window, weights=start, rows=rows, terms=terms, columns=columns)
    channels = np.empty((1, rows * columns), np.float32)
    ProgramEvaluator(builder.finish(window, result)).evaluate(values.reshape(1, -1), channels)
    return channels.reshape(rows, columns)


@given(
    rows=st.integers(1, 20),
    terms=st.integers(1, 40),
    columns=st.integers(1, 3 * LANES),
    seed=st.integers(0, 2**32 - 1),
)
@settings(max_examples=200, deadline=None)
def test_a_layer_is_as_exact_as_float32_allows(rows: int, terms: int, columns: int, seed: int) -> None:
    generator = np.random.default_rng(seed)
    values = generator.normal(size=(rows, terms)).astype(np.float32)
    sizes = generator.uniform(0, 10, columns)
    weights = (generator.normal(size=(terms, columns)) * sizes).astype(np.float32)
    bias = generator.normal(size=columns).astype(np.float32)
    expected = values.astype(np.float64) @ weights + bias
    # A sum's rounding errors, and half a step of each weight.
    parts = np.abs(values).astype(np.float64) @ np.abs(weights) + np.abs(bias)
    steps = np.abs(values).astype(np.float64).sum(axis=1)[:, None] * np.abs(weights).max(axis=0) * 2.0**-23
    bound = (terms + 2) * 2.0**-24 * parts + (rows == 1) * steps
    np.testing.assert_array_less(np.abs(evaluate(values, weights, bias) - expected), bound + 1e-30)


def test_weights_of_24_bits_cost_a_sum_no_more_than_float32_does() -> None:
    generator = np.random.default_rng(0)
    terms, columns = 1000, 500
    values = generator.normal(size=(1, terms)).astype(np.float32)
    weights = generator.uniform(-1, 1, size=(terms, columns)).astype(np.float32) / np.float32(terms**0.5)
    exact = values.astype(np.float64) @ weights
    bias = np.zeros(columns, np.float32)
    of_24_bits = np.abs(evaluate(values, weights, bias) - exact).max()
    of_float32 = np.abs(evaluate(np.repeat(values, 2, axis=0), weights, bias) - exact).max()
    assert of_24_bits < 1.5 * of_float32


@pytest.mark.parametrize("rows", [1, 2])
def test_columns_of_nothing_and_of_one_size(rows: int) -> None:
    weights = np.zeros((3, 5), np.float32)
    weights[:, 1:] = [1, -1, 0.5, 2.0**-30]
    result = evaluate(np.ones((rows, 3), np.float32), weights, np.zeros(5, np.float32))
    np.testing.assert_allclose(result, 3 * weights[:rows], rtol=2.0**-22)
