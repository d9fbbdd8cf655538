import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from taxel_bench.load.arrivals import poisson_arrivals

seeds = st.integers(0, 2**32)
rates = st.floats(0.1, 1e5)


@given(rate=rates, queries=st.integers(1, 200), seed=seeds)
def test_arrivals_ascend_and_are_the_same_for_a_seed(rate: float, queries: int, seed: int) -> None:
    arrivals = poisson_arrivals(rate, queries, seed)
    assert arrivals.shape == (queries,)
    assert arrivals[0] > 0
    assert (np.diff(arrivals) > 0).all()
    np.testing.assert_array_equal(arrivals, poisson_arrivals(rate, 2 * queries, seed)[:queries])


@given(rate=rates, seed=seeds)
def test_the_rate_only_stretches_time(rate: float, seed: int) -> None:
    np.testing.assert_allclose(poisson_arrivals(rate, 50, seed) * rate, poisson_arrivals(1, 50, seed))


@pytest.mark.parametrize("seed", range(3))
def test_gaps_are_exponential_and_counts_are_poisson(seed: int) -> None:
    rate, queries = 200.0, 20_000
    arrivals = poisson_arrivals(rate, queries, seed)
    gaps = np.diff(arrivals, prepend=0)
    assert stats.kstest(gaps, stats.expon(scale=1 / rate).cdf).pvalue > 0.01
    assert abs(np.corrcoef(gaps[:-1], gaps[1:])[0, 1]) < 4 / np.sqrt(queries)
    counts = np.histogram(arrivals, np.arange(0, 95, 0.1))[0]
    # A Poisson count's variance is its mean.
    assert counts.mean() == pytest.approx(rate * 0.1, rel=0.05)
    assert counts.var() == pytest.approx(rate * 0.1, rel=0.2)
