"""The layout for few rows: trees side by side, each split into a top tree and leaf blocks.

A leaf block is a subtree with at most a given number of leaves, and its parent's subtree has more. The top
tree is everything above the leaf blocks. In the in-order numbering, inner node i stands between leaves i
and i + 1. So a block's leaves stand between two neighbouring nodes of the top tree, and the top tree is
itself a tree in order; its leaves are the blocks.

With blocks of eight leaves, each block takes one cache line: a row reads little of a tree, and it is known
early what it reads. With blocks of one leaf, the whole tree is top tree: several rows read the same nodes.
"""

from dataclasses import dataclass
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray

from taxel_server.runtimes.compiled.compiling import compiled
from taxel_server.runtimes.trees.layout.columns import Columns
from taxel_server.runtimes.trees.layout.in_order import InOrder
from taxel_server.runtimes.trees.simd.lookups import can_look_up

BLOCK_LEAVES: Final = 8
"""The most leaves of a block, where blocks have more than one leaf."""

LINE: Final = 64
"""Bytes of such a block: its leaves as float32, its nodes' columns, limits and masks, eight bytes each.

A node's mask has the bits of the leaves that a row can still reach after it went right there.
"""

COLUMNS_AT: Final = 4 * BLOCK_LEAVES
LIMITS_AT: Final = COLUMNS_AT + BLOCK_LEAVES
MASKS_AT: Final = LIMITS_AT + BLOCK_LEAVES

MOST_EXITS: Final = {8: 127, 16: 32767}
"""The most leaf blocks of a tree, by the bits of an exit, a signed integer."""

COLUMN_BITS: Final = 5
"""How many bits a column takes of a byte that it shares with a distance."""

_LAST_COLUMN: Final = 2**COLUMN_BITS - 1
_MOST_DISTANT: Final = 2 ** (8 - COLUMN_BITS) - 1

_TABLE_SIZES: Final = (16, 32, 48, 64, 128, 256)
"""The possible lengths of a row's ranks. At least one rank of padding, 0, stands behind the columns."""


def fits_lanes(columns: Columns) -> bool:
    """Whether the processor can look up the ranks of these columns."""
    return can_look_up() and len(columns) < _TABLE_SIZES[-1]


def table_size(columns: Columns) -> int:
    """The length of a row's ranks, for columns that fit lanes (`fits_lanes`)."""
    return next(size for size in _TABLE_SIZES if size > len(columns))


@dataclass(frozen=True)
class TopTrees:
    """Top trees in groups; a group has one tree for each lane of a kernel.

    A node's distance is the number of blocks in its left subtree, less 1.

    Attributes:
        bits: the size of a block's number in its tree, 8 or 16.
        packed: whether a node takes two bytes, because its column and its distance share one.
        steps: (groups,) int64, nodes of each group's largest tree.
        start: (groups + 1,) int64, each group's first byte in `nodes`.
        nodes: (bytes,) uint8, for every step the columns, limits and distances of the group's trees, or
            the columns below the distances, less 128, and the limits.
    """

    bits: int
    packed: bool
    steps: NDArray[np.int64]
    start: NDArray[np.int64]
    nodes: NDArray[np.uint8]

    @classmethod
    def of(
        cls, index: InOrder, columns: Columns, trees: NDArray[np.int64], most: int, may_pack: bool
    ) -> Self:
        """Lays out the trees (groups, lanes), -1 for no tree, with at most `most` leaves in a block."""
        blocks = np.append(count_blocks(index, most), 1)
        distance = _distances(index, most)
        bits = 8 if blocks.max() <= MOST_EXITS[8] else 16
        small = len(columns) <= _LAST_COLUMN and int(distance.max(initial=0)) <= _MOST_DISTANT
        packed = may_pack and bits == 8 and small
        each = 2 if packed else 2 + bits // 8
        steps = blocks[trees].max(axis=1, initial=1) - 1
        start = np.concatenate([[0], np.cumsum(each * trees.shape[1] * steps)])
        # Padding is a node where no row goes right. Its distance is -1; or, if packed, its column is the
        # one behind the last, whose rank is below the limit.
        nodes = np.full(start[-1], 255, dtype=np.uint8)
        if packed:
            nodes.reshape(-1, 2, trees.shape[1])[:] = [[len(columns) + 128], [127]]
        _put_top_trees(
            trees,
            start,
            each,
            index.leaves,
            index.node_start,
            columns.column,
            columns.limit,
            distance,
            nodes,
        )
        return cls(bits, packed, steps, start, nodes)


@dataclass(frozen=True)
class LeafBlocks:
    """The blocks of BLOCK_LEAVES leaves of trees by place.

    Attributes:
        first: (lanes,) int64, the first block of each lane's first tree; the lane's other blocks follow.
        counts: (groups, lanes) int64, each tree's number of blocks.
        lines: (blocks, LINE) uint8; a place without a tree has one line, whose leaf adds nothing.
    """

    first: NDArray[np.int64]
    counts: NDArray[np.int64]
    lines: NDArray[np.uint8]

    @classmethod
    def of(cls, index: InOrder, columns: Columns, trees: NDArray[np.int64]) -> Self:
        """Lays out the trees (groups, lanes), -1 for no tree."""
        counts = np.append(count_blocks(index, BLOCK_LEAVES), 1)[trees]
        # A lane without any tree always reads the same line.
        counts[:-1, (trees < 0).all(axis=0)] = 0
        # Lanes lie far apart: the processor must not prefetch what lies between two trees of a group.
        tree, apart = trees.T.ravel(), counts.T.ravel()
        first = np.cumsum(apart) - apart
        lines = np.zeros((int(counts.sum()), LINE), dtype=np.uint8)
        lines[:, MASKS_AT:] = 255
        lines[:, :COLUMNS_AT].view(np.float32)[first[tree < 0]] = -0.0
        _put_blocks(
            tree,
            first,
            index.leaves,
            index.node_start,
            index.leaf_start,
            columns.column,
            columns.limit,
            index.first,
            index.last,
            index.value.view(np.uint8),
            lines,
        )
        return cls(first[:: len(trees)], counts, lines)


def count_blocks(index: InOrder, most: int) -> NDArray[np.int64]:
    """(trees,) How many blocks of at most `most` leaves each tree has."""
    above = np.concatenate([[0], np.cumsum(index.last - index.first >= most)])
    blocks: NDArray[np.int64] = 1 + above[index.node_start + index.leaves - 1] - above[index.node_start]
    return blocks


def _distances(index: InOrder, most: int) -> NDArray[np.int64]:
    """(inner nodes,) The number of blocks in a top node's left subtree, less 1; -1 for other nodes."""
    on_top = index.last - index.first >= most
    before = np.concatenate([[0], np.cumsum(on_top)])
    tree = np.repeat(index.node_start, index.leaves - 1)
    distances: NDArray[np.int64] = before[:-1] - before[tree + index.first]
    return np.where(on_top, distances, -1)


@compiled
def _put_top_trees(
    trees: NDArray[np.int64],
    start: NDArray[np.int64],
    each: int,
    leaves: NDArray[np.int64],
    node_start: NDArray[np.int64],
    column: NDArray[np.int32],
    limit: NDArray[np.int8],
    distance: NDArray[np.int64],
    nodes: NDArray[np.uint8],
) -> None:
    lanes = trees.shape[1]
    for group in range(trees.shape[0]):
        for lane in range(lanes):
            tree, step = trees[group, lane], start[group]
            if tree < 0:
                continue
            for node in range(node_start[tree], node_start[tree] + leaves[tree] - 1):
                if distance[node] < 0:
                    continue
                nodes[step + lanes + lane] = np.uint8(limit[node])
                if each == 2:
                    nodes[step + lane] = np.uint8((distance[node] << COLUMN_BITS | column[node]) - 128)
                else:
                    nodes[step + lane] = column[node]
                    for byte in range(each - 2):
                        place = step + 2 * lanes + (each - 2) * lane + byte
                        nodes[place] = np.uint8(distance[node] >> (8 * byte))
                step += each * lanes


@compiled
def _put_blocks(
    trees: NDArray[np.int64],
    first_block: NDArray[np.int64],
    leaves: NDArray[np.int64],
    node_start: NDArray[np.int64],
    leaf_start: NDArray[np.int64],
    column: NDArray[np.int32],
    limit: NDArray[np.int8],
    first: NDArray[np.int32],
    last: NDArray[np.int32],
    value: NDArray[np.uint8],
    lines: NDArray[np.uint8],
) -> None:
    for place in range(trees.size):
        tree = trees[place]
        if tree < 0:
            continue
        line, begin = first_block[place], 0
        for leaf in range(leaves[tree]):
            slot, source = leaf - begin, 4 * (leaf_start[tree] + leaf)
            for byte in range(4):
                lines[line, 4 * slot + byte] = value[source + byte]
            if leaf == leaves[tree] - 1:
                break
            node = node_start[tree] + leaf
            if last[node] - first[node] >= BLOCK_LEAVES:
                begin, line = leaf + 1, line + 1
            else:
                lines[line, COLUMNS_AT + slot] = column[node]
                lines[line, LIMITS_AT + slot] = np.uint8(limit[node])
                left_out = (2 << slot) - (1 << (first[node] - begin))
                lines[line, MASKS_AT + slot] = np.uint8(255 - left_out)
