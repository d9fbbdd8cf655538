"""The running mean of a column, inside each part of a recording."""

from collections.abc import Iterable

import numpy as np
from scipy.ndimage import uniform_filter1d

from taxel_models.loop.basis import Floats


def mean_within(values: Floats, window: int, parts: Iterable[slice]) -> Floats:
    """(…, n, k) means of values (…, n, k) over a window of rows around each of the n, inside its part.

    Beyond an end of a part, its last value counts on.

    Args:
        window: rows.
        parts: of the rows; each row is in one of them.
    """
    means = np.empty_like(values)
    for part in parts:
        means[..., part, :] = uniform_filter1d(values[..., part, :], window, axis=-2, mode="nearest")
    return means
