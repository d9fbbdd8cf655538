"""Parts of the evaluation of forests that can be switched off, to measure how much time each saves."""

from dataclasses import dataclass
from typing import Final

from taxel_server.runtimes.compiled.processor import processor_has


@dataclass(frozen=True)
class Switches:
    """The evaluators, and the special cases within them.

    Attributes:
        leaf_blocks: the evaluator of a row or two.
        small_batch: the evaluator of some rows of trees with at most 127 leaves.
        bitset_64: the evaluator of blocks of 64 rows.
        bitset_256: the evaluator of blocks of 256 rows.
        packed_nodes: a node's column and distance in one byte, with AVX-512.
        upper_levels: the upper levels of trees laid out as if they were full.
        byte_tables: leaves looked up by byte shuffles.
        next_nodes: asking for a group's nodes while the one before is evaluated.
        next_leaves: asking for leaves before they are needed.
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
    """Whether few rows wait for memory, as with AVX-512, rather than for the processor.

    Then fewer bytes a node, and asking for nodes ahead, save more time than their instructions take.
    """
    return processor_has("avx512bw")
