"""Switches of the evaluation of forests: `bench forms` turns each off and measures what it costs."""

from dataclasses import dataclass
from typing import Final

from taxel_server.runtimes.compiled.processor import processor_has


@dataclass(frozen=True)
class Switches:
    """The evaluators and the special cases within them.

    Attributes:
        leaf_blocks: the evaluator of one or two rows.
        small_batch: the evaluator of a few rows, for trees with at most 127 leaves.
        bitset_64: the evaluator of blocks of 64 rows.
        bitset_256: the evaluator of blocks of 256 rows.
        packed_nodes: one byte holds a node's column and distance; with AVX-512.
        upper_levels: the upper levels of trees are laid out as if they were full.
        byte_tables: byte shuffles look leaves up.
        next_nodes: a group's nodes are prefetched while the group before it is evaluated.
        next_leaves: leaves are prefetched.
    """

    leaf_blocks: bool = True
    small_batch: bool = True
    bitset_64: bool = True
    bitset_256: bool = True
    packed_nodes: bool = True
    upper_levels: bool = True
    byte_tables: bool = True
    next_nodes: bool = True
    next_leaves: bool = True


ALL_ON: Final = Switches()


def waits_for_memory() -> bool:
    """Whether the evaluation of few rows waits for memory, not for the processor, as with AVX-512.

    Then packed nodes and prefetched nodes save more time than their instructions take.
    """
    return processor_has("avx512bw")
