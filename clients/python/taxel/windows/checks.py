"""The checks of windows before a model gets them: shape, datatype, and values that a model can take."""

from math import hypot
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from taxel.errors import InvalidArgument

_FLOAT: Final = np.dtype("<f4")

LARGEST: Final = 1e6
"""No place in m, force in N or count comes near it. Products of much larger numbers leave float32."""

POSSIBLE: Final = f"finite numbers, at most {LARGEST:g} in size"
"""What is expected of places, forces and extra features, in words."""

_FEW_VALUES: Final = 72
"""The number of values in one window of the widest combination."""


def check_windows(windows: NDArray[Any], features: tuple[str, ...]) -> NDArray[np.float32]:
    """Windows as a C-contiguous (n, f) float32 array.

    Raises:
        InvalidArgument: wrong shape or datatype, no rows, or a value not finite or beyond `LARGEST`.
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
    check_values(array, features)
    return array


def _as_float32(array: NDArray[Any]) -> NDArray[np.float32]:
    if array.dtype.kind not in "fiu":
        raise InvalidArgument(f"window: datatype {array.dtype}: expected numbers, best float32")
    # A value too large for float32 becomes infinite, and is refused below.
    with np.errstate(over="ignore"):
        return array.astype(np.float32)


def check_values(windows: NDArray[np.float32], features: tuple[str, ...]) -> None:
    """Refuse NaN and values beyond `LARGEST`, naming the first by row and feature.

    Raises:
        InvalidArgument: there is such a value.
    """
    # With cold caches, NumPy's way takes three times as long. No comparison with NaN is true.
    if windows.size <= _FEW_VALUES and hypot(*windows.ravel().tolist()) <= LARGEST:
        return
    if not (windows.min(initial=0.0) >= -LARGEST and windows.max(initial=0.0) <= LARGEST):
        possible = np.abs(windows) <= LARGEST
        row, column = (int(index) for index in np.argwhere(~possible)[0])
        raise InvalidArgument(
            f"window[{row}, {features[column]!r}] is {windows[row, column]:g}: expected a finite number, "
            f"at most {LARGEST:g} in size"
        )
