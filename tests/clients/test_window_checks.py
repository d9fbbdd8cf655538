"""The checks of windows before a model gets them."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from taxel.errors import InvalidArgument
from taxel.windows.checks import check_values, check_windows

FEATURES = ("x", "y", "z", "fx", "fy", "fz")


def test_other_numbers_become_float32() -> None:
    checked = check_windows(np.arange(12).reshape(2, 6)[:, ::-1], FEATURES)
    assert checked.dtype == np.float32
    assert checked.flags.c_contiguous
    np.testing.assert_array_equal(checked[0], [5, 4, 3, 2, 1, 0])


def test_good_float32_is_not_copied() -> None:
    windows = np.zeros((3, 6), np.float32)
    assert check_windows(windows, FEATURES) is windows


@pytest.mark.parametrize(
    ("windows", "message"),
    [
        (np.zeros(6), r"shape \(6,\): expected \(n, 6\)"),
        (np.zeros((2, 5)), r"shape \(2, 5\): expected \(n, 6\)"),
        (np.zeros((0, 6)), "no rows"),
        (np.full((1, 6), "a"), "datatype"),
        (np.zeros((1, 6), complex), "datatype complex128"),
        (np.array([[0, 0, 0, 0, np.nan, 0]]), r"window\[0, 'fy'\] is nan"),
        (np.array([[0] * 6, [0, 0, 1e39, 0, 0, 0]]), r"window\[1, 'z'\] is inf"),
        (np.array([[0, 0, 0, -1e30, 0, 0]]), r"'fx'\] is -1e\+30: expected .* at most 1e\+06"),
        (np.where(np.arange(600) == 77, 2e6, 0.0).reshape(100, 6), r"window\[12, 'fz'\] is 2e\+06"),
        (np.where(np.arange(600) == 77, np.nan, 0.0).reshape(100, 6), r"window\[12, 'fz'\] is nan"),
    ],
)
def test_what_no_model_takes_is_refused(windows: NDArray[Any], message: str) -> None:
    with pytest.raises(InvalidArgument, match=message):
        check_windows(windows, FEATURES)


def test_minus_infinity_is_refused() -> None:
    with pytest.raises(InvalidArgument, match=r"window\[0, 'x'\] is -inf"):
        check_values(np.full((1, 6), -np.inf, np.float32), FEATURES)
