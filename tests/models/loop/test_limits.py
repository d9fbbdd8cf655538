"""The limits of counts, and what is fitted within them."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from taxel.channels import COUNTS_MAX
from taxel_models.loop.limits import Limits

ROWS = 2_000


def pressed(seed: int) -> np.ndarray:
    """(n, 21) counts of a tared sensor: half of the time in free air."""
    random = np.random.default_rng(seed)
    return np.maximum(random.normal(size=(ROWS, 21)) * 40.0, 0.0)


@given(st.integers(0, 2**32 - 1), st.floats(-30.0, 30.0))
def test_a_constant_is_found_though_counts_end_at_0(seed: int, constant: float) -> None:
    predicted = pressed(seed)
    measured = np.maximum(predicted + constant, 0.0)
    limits = Limits.of(measured)
    weights = limits.fitted(3, np.ones((ROWS, 1)), measured[:, 3], predicted[:, 3])
    assert weights == pytest.approx([constant], abs=1e-6)
    share = limits.share_of_constants(measured, predicted)
    assert share.min() >= 0.0
    assert share.max() <= 1.0 + 1e-9
    np.testing.assert_allclose(predicted + share * constant, measured, atol=1e-5)


def test_far_from_limits_all_of_a_constant_shows() -> None:
    predicted = pressed(1) + 500.0
    measured = predicted - 30.0
    limits = Limits.of(measured)
    assert (limits.share_of_constants(measured, predicted) == 1.0).all()
    assert not limits.beyond(measured, predicted).any()


def test_what_leads_beyond_a_limit_is_no_error_of_a_channel_that_is_at_it() -> None:
    measured = np.array([[0.0, 3.0, COUNTS_MAX, 7.0]])
    predicted = np.array([[-5.0, -5.0, COUNTS_MAX + 2.0, 9.0]])
    limits = Limits.of(measured)
    np.testing.assert_array_equal(limits.beyond(measured, predicted), [[-5.0, 0.0, 2.0, 0.0]])
    np.testing.assert_array_equal(limits.shown(predicted), [[0.0, 0.0, COUNTS_MAX, 9.0]])


def test_a_channel_that_was_beyond_a_limit_has_none() -> None:
    measured = np.array([[-1.0, 0.0, 0.0], [0.0, 0.0, COUNTS_MAX + 1.0]])
    limits = Limits.of(measured)
    np.testing.assert_array_equal(limits.low, [-np.inf, 0.0, 0.0])
    np.testing.assert_array_equal(limits.high, [COUNTS_MAX, COUNTS_MAX, np.inf])
    assert not limits.beyond(measured, np.array([[-9.0, 1.0, 1.0]] * 2)).any()
