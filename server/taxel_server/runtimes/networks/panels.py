"""Lays out a dense layer's weights as panels. A panel holds a few columns and is read in one stream.

For one row, reading the weights takes the time. So they become 24-bit integers, in units of 2**-23 of the
power of two above their column's largest weight. This is a quarter less to read than float32, and the error
is at most 2**-24 of that power: each addition of float32 rounds off as much. For more rows, the products
take the time, and the weights stay float32.
"""

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from taxel_server.runtimes.networks.panel_product import HALVES, LANES

_FRACTIONS: Final = 2**23

_STORED: Final = np.argsort([lane for half in HALVES for lane in half])
"""The column at each place of a row of 24-bit integers."""


def panels_of(weights: NDArray[Any], bias: NDArray[Any], exact: bool) -> NDArray[np.uint8]:
    """The panels of weights (terms, columns); the panel of the last columns comes first.

    Each panel holds `terms` rows of `LANES` weights, then the columns' scales and biases, both float32.

    Args:
        exact: whether the weights are float32, not 24-bit integers.
    """
    terms, columns = weights.shape
    count = -(-columns // LANES)
    padded = np.zeros((terms + 1, count * LANES))
    padded[:terms, :columns], padded[terms, :columns] = weights, bias
    by_panel = padded.reshape(terms + 1, count, LANES).transpose(1, 0, 2)[::-1]
    rows, biases = by_panel[:, :terms], by_panel[:, terms:]
    scales = np.ones_like(biases)
    if exact:
        content = rows.astype(np.float32, order="C").view(np.uint8)
    else:
        _, exponents = np.frexp(np.abs(rows).max(axis=1, keepdims=True))
        scales = np.ldexp(1.0 / _FRACTIONS, exponents)
        integers = np.rint((rows / scales)[:, :, _STORED]).clip(-_FRACTIONS, _FRACTIONS - 1)
        stored = integers.astype(np.int32, order="C")
        lower, upper = (stored & 0xFFFF).astype(np.uint16), (stored >> 16).astype(np.int8)
        content = np.concatenate([lower.view(np.uint8), upper.view(np.uint8)], axis=2)
    ends = np.concatenate([scales, biases], axis=1).astype(np.float32).view(np.uint8)
    return np.hstack([content.reshape(count, -1), ends.reshape(count, -1)]).reshape(-1)
