"""Top trees side by side: the kernel's exits are those of the in-order rule."""

from typing import Any

import numba
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from taxel_server.runtimes.compiled.vectors import call
from taxel_server.runtimes.trees.few_rows.kernels import find_exits, trees_at_once
from taxel_server.runtimes.trees.layout.tree_lanes import COLUMN_BITS
from taxel_server.runtimes.trees.simd.lookups import can_look_up

COLUMNS = 31
TABLE = 32
ROWS = 3

pytestmark = pytest.mark.skipif(not can_look_up(), reason="this processor has no byte shuffle")


@numba.njit
def traverse(
    address: int, nodes: NDArray[Any], steps: int, ranks: NDArray[Any], rows: int, exits: NDArray[Any]
) -> None:
    call(address, (nodes.ctypes.data, steps, ranks.ctypes.data, rows, exits.ctypes.data, 0))


def exits_by_rule(goes_right: NDArray[np.bool_], distance: NDArray[np.int64]) -> NDArray[np.int64]:
    """(rows, lanes) From (rows, steps, lanes) and (steps, lanes)."""
    exits = np.zeros((goes_right.shape[0], goes_right.shape[2]), dtype=np.int64)
    for node in range(goes_right.shape[1]):
        first = node - distance[node]
        exits = np.where(goes_right[:, node] & (exits >= first), node + 1, exits)
    return exits


@pytest.mark.parametrize(("bits", "packed"), [(8, False), (16, False), (8, True)])
@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), rows=st.integers(1, ROWS), steps=st.integers(0, 126))
def test_exits_are_those_of_the_rule(bits: int, packed: bool, seed: int, rows: int, steps: int) -> None:
    generator = np.random.default_rng(seed)
    shape = steps, trees_at_once()
    column = generator.integers(COLUMNS, size=shape)
    # Few rows go right, often: what is reached late in a long tree counts, too.
    limit = generator.integers(-128 + generator.integers(255), 128, size=shape)
    distance = generator.integers(0, np.minimum(8 if packed else 127, 1 + np.arange(steps))[:, None], shape)
    ranks = generator.integers(-128, 128, size=(rows, TABLE)).astype(np.int8)
    apart = [column.astype(np.int8), limit.astype(np.int8), distance.astype(f"i{bits // 8}")]
    sharing = [((distance << COLUMN_BITS | column) - 128).astype(np.int8), limit.astype(np.int8)]
    nodes = np.hstack([part.view(np.int8) for part in (sharing if packed else apart)])
    exits = np.full((rows, shape[1]), 77, dtype=f"u{bits // 8}")
    traverse(find_exits(TABLE, bits, packed, True), nodes.ravel(), steps, ranks, rows, exits)
    np.testing.assert_array_equal(exits, exits_by_rule(ranks[:, column] >= limit, distance))
