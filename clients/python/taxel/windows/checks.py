"""The checks of windows before a model gets them: shape, datatype, and finite values."""

from math import isfinite
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from taxel.errors import InvalidArgument

_FLOAT: Final = np.dtype("<f4")

_FEW_VALUES: Final = 72
"""The number of values in one window of the widest combination. Their sum in Python's float is finite if
all of them are finite, because a sum of float32 cannot overflow there."""


def check_windows(windows: NDArray[Any], features: tuple[str, ...]) -> NDArray[np.float32]:
    """Windows as a C-contiguous (n, f) float32 array.

    Raises:
        InvalidArgument: wrong shape or datatype, no rows, or a value that is not finite.
    """
    array = np.asarray(windows)
    if array.dtype != _FLOAT:
        array = _as_float32(array)
    if array.ndim != 2 or array.shape[1] != len(features):
        raise InvalidArgument(f"window: shape {array.shape}: expected (n, {len(features)})")
    if not len(array):
        raise InvalidArgument("window: no rows: expected at least one window")
    if not array.flags.c_contiguous:
        array = np.ascontiguousarray(array)
    check_finite(array, features)
    return array


def _as_float32(array: NDArray[Any]) -> NDArray[np.float32]:
    if array.dtype.kind not in "fiu":
        raise InvalidArgument(f"window: datatype {array.dtype}: expected numbers, best float32")
    # A value too large for float32 becomes infinite, and is refused below.
    with np.errstate(over="ignore"):
        return array.astype(np.float32)


def check_finite(windows: NDArray[np.float32], features: tuple[str, ...]) -> None:
    """Refuse NaN and infinities, naming the first by row and feature.

    Raises:
        InvalidArgument: a value is not finite.
    """
    # With cold caches, NumPy's way takes three times as long.
    if windows.size <= _FEW_VALUES and isfinite(sum(map(sum, windows.tolist()))):
        return
    finite = np.isfinite(windows)
    if not finite.all():
        row, column = (int(index) for index in np.argwhere(~finite)[0])
        value = windows[row, column]
        raise InvalidArgument(f"window[{row}, {features[column]!r}] is {value}: expected a finite number")
