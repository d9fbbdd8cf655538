"""Bitset traversal: every node of a tree splits the set of rows that reach it, a vector of bits."""

from functools import cache
from typing import Final

from taxel_server.runtimes.compiled.compiling import address_of, compiled, inlined
from taxel_server.runtimes.compiled.vectors import (
    Vector,
    both,
    either,
    exclusive,
    integer_at,
    load,
    splat,
    store,
)
from taxel_server.runtimes.trees.layout.bitsets import GROUP, RECORDS, SET_BYTES, TOGETHER
from taxel_server.runtimes.trees.simd.bits import number, put_numbers
from taxel_server.runtimes.trees.simd.vectors64 import elements, int64s_at, widen

_GROUP: Final = GROUP.itemsize
_STEPS_AT, _SIXTEENS_AT, _TREES_AT = 8, 16, 24

_UNION: Final = 16
_UNIONS_OF_4096: Final = _UNION + 1
_UNIONS_OF_256: Final = _UNIONS_OF_4096 + 16
_UNIONS: Final = _UNIONS_OF_256 + 256
_LEAVES: Final = _UNIONS + 4096
"""Places in a kernel's memory, in sets: the sets of the leaf numbers, and the unions of 16, of 256, of 4096
and of all of them. The first 16 sets are the bits of every row's leaf number."""

_APART: Final = 256
"""The distance in sets from one tree's sets to the next tree's, where trees of 256 rows take turns."""

_VECTORS: Final = {
    (1, 64): (8, 1, 8),
    (2, 64): (4, 1, 8),
    (1, 256): (4, 4, 32 * _APART),
    (2, 256): (4, 4, 32 * _APART),
}
"""For the bytes of a leaf number and the rows of a block: the 64-bit lanes of a vector, the lanes of one
tree's set of rows, and the distance in bytes from one tree's sets to the next tree's."""

_IN_TURN: Final = {(1, 64): 8, (2, 64): 4, (1, 256): 4, (2, 256): 1}
"""How many trees take their steps in turn."""

_IN_REGISTERS: Final = 4
"""Up to so many groups of sixteen leaves, rows are numbered in registers, without memory."""


def memory_size(numbers: int) -> int:
    """How many 64-bit integers of zeroed memory trees with so many leaf numbers need."""
    return (_LEAVES + max(numbers + 16, 2 * _APART)) * 8


@cache
def find_exits(number_bytes: int, rows: int) -> int:
    """Compiles the traversal of groups of trees by a block of 64 or 256 rows; gives its address.

    The function takes:
        the number of groups
        the address of the first group
        the address of all records
        the number of places in upper levels
        the address of the sets that these places split (`split_sets`)
        the address of the block's comparisons [comparison][row], a bit each
        the address of the memory
        the address of the block's exits [place][byte][lane], which it writes

    Row 8 j + k goes to lane k rows / 8 + j. With 64 rows, all trees of a group share a vector, and each
    tree has one lane. With 256 rows, each tree has a vector, and some trees take their steps in turn.
    """
    (vector, lanes, apart), turns = _VECTORS[number_bytes, rows], _IN_TURN[number_bytes, rows]
    together, record = TOGETHER[number_bytes], RECORDS[number_bytes].itemsize
    bits, size, share, narrow = 4 * record, 8 * vector, vector // lanes, number_bytes == 1
    scale, copies = size // SET_BYTES, turns // share

    @address_of("void(intp, intp, intp, intp, intp, intp, intp, intp)")
    def traverse(
        count: int,
        groups: int,
        records: int,
        upper: int,
        sets: int,
        comparisons: int,
        memory: int,
        exits: int,
    ) -> None:
        _clear(memory, integer_at(groups + _GROUP * (count - 1) + _SIXTEENS_AT, 64), copies, vector)
        leaves = memory + size * _LEAVES
        for group in range(groups, groups + _GROUP * count, _GROUP):
            start = records + integer_at(group, 64)
            steps = integer_at(group + _STEPS_AT, 64)
            sixteens = integer_at(group + _SIXTEENS_AT, 64)
            for first in range(0, together, turns):
                for copy in range(copies):
                    store(leaves + apart * copy, splat(-1, 64, vector))
                node, new = start + record // 2 * first, leaves
                for place in range(upper):
                    new += size
                    at = leaves + scale * integer_at(sets + 8 * place, 64)
                    if share == 1:
                        _split_in_turn(node, comparisons, at, new, apart, turns)
                    else:
                        right = int64s_at(elements(comparisons, widen(load(node, bits, vector)), 8))
                        _split(at, right, new, vector)
                    node += record // 2 * together
                node = start + record // 2 * together * upper + record * first
                for _ in range(steps):
                    new += size
                    for tree in range(turns):
                        its_node, offset = node + record * tree, apart * tree
                        right = load(comparisons + 8 * lanes * integer_at(its_node, bits), 64, lanes)
                        at = leaves + scale * integer_at(its_node + record // 2, bits)
                        _split(at + offset, right, new + offset, lanes)
                    node += record * together
                for copy in range(copies):
                    places = group + _TREES_AT + 8 * (first + copy)
                    its_leaves = leaves + apart * copy
                    _put(narrow, memory, its_leaves, sixteens, exits, rows, places, share, vector)

    return traverse


@inlined
def _split(place: int, goes_right: Vector, new: int, lanes: int) -> None:
    """Splits a set of rows: the left child keeps the set's place, the right child gets a new place."""
    reaching = load(place, 64, lanes)
    right = both(reaching, goes_right)
    store(place, exclusive(reaching, right))
    store(new, right)


@inlined
def _split_in_turn(node: int, comparisons: int, place: int, new: int, apart: int, trees: int) -> None:
    """Splits the sets of 256 rows that reach a place of the upper levels of some trees."""
    for tree in range(trees):
        goes_right = load(comparisons + 32 * integer_at(node + 2 * tree, 16), 64, 4)
        _split(place + apart * tree, goes_right, new + apart * tree, 4)


@inlined
def _number_by_sixteens(sets: int, sixteens: int, unions: int, bits: int, lanes: int) -> None:
    """Writes four bits of the number of each row's set, and the unions of every sixteen sets."""
    bit0 = splat(0, 64, lanes)
    bit1 = bit0
    bit2 = bit0
    bit3 = bit0
    for sixteen in range(sixteens):
        found = number(sets + 128 * lanes * sixteen, 16, lanes)
        bit0 = either(bit0, found[0])
        bit1 = either(bit1, found[1])
        bit2 = either(bit2, found[2])
        bit3 = either(bit3, found[3])
        store(unions + 8 * lanes * sixteen, found[4])
    store(bits, bit0)
    store(bits + 8 * lanes, bit1)
    store(bits + 16 * lanes, bit2)
    store(bits + 24 * lanes, bit3)


@inlined
def _put_bits(bits: int, exits: int, places: int, trees: int, lanes: int) -> None:
    eight = (
        load(bits, 64, lanes),
        load(bits + 8 * lanes, 64, lanes),
        load(bits + 16 * lanes, 64, lanes),
        load(bits + 24 * lanes, 64, lanes),
        load(bits + 32 * lanes, 64, lanes),
        load(bits + 40 * lanes, 64, lanes),
        load(bits + 48 * lanes, 64, lanes),
        load(bits + 56 * lanes, 64, lanes),
    )
    put_numbers(eight, exits, places, trees)


@inlined
def _put_narrow(
    memory: int, leaves: int, sixteens: int, exits: int, places: int, trees: int, lanes: int
) -> None:
    """Writes the number of the leaf that each row reached, in one byte."""
    if sixteens <= 2:
        put_numbers(number(leaves, 32, lanes)[:-1], exits, places, trees)
    elif sixteens == 3:
        put_numbers(number(leaves, 48, lanes)[:-1], exits, places, trees)
    elif sixteens == 4:
        put_numbers(number(leaves, 64, lanes)[:-1], exits, places, trees)
    else:
        size = 8 * lanes
        unions, union = memory + size * _UNIONS, memory + size * _UNIONS_OF_256
        _number_by_sixteens(leaves, sixteens, unions, memory, lanes)
        _number_by_sixteens(unions, 1, union, memory + 4 * size, lanes)
        _put_bits(memory, exits, places, trees, lanes)


@inlined
def _put_wide(
    memory: int, leaves: int, sixteens: int, exits: int, apart: int, places: int, trees: int, lanes: int
) -> None:
    """Writes the number of each row's leaf in two bytes; the upper one stands `apart` bytes behind."""
    size = 8 * lanes
    unions, unions256 = memory + size * _UNIONS, memory + size * _UNIONS_OF_256
    unions4096, union = memory + size * _UNIONS_OF_4096, memory + size * _UNION
    _number_by_sixteens(leaves, sixteens, unions, memory, lanes)
    sixteens = (sixteens + 15) // 16
    _number_by_sixteens(unions, sixteens, unions256, memory + 4 * size, lanes)
    sixteens = (sixteens + 15) // 16
    _number_by_sixteens(unions256, sixteens, unions4096, memory + 8 * size, lanes)
    _number_by_sixteens(unions4096, 1, union, memory + 12 * size, lanes)
    _put_bits(memory, exits, places, trees, lanes)
    _put_bits(memory + 8 * size, exits + apart, places, trees, lanes)


@inlined
def _put(
    narrow: bool,
    memory: int,
    leaves: int,
    sixteens: int,
    exits: int,
    apart: int,
    places: int,
    trees: int,
    lanes: int,
) -> None:
    """Writes the number of the leaf that each row reached, in one byte or two.

    The kernels call this function by its name. If a kernel closed over it, each process would see another
    function, and numba's cache would never be used.
    """
    if narrow:
        _put_narrow(memory, leaves, sixteens, exits, places, trees, lanes)
    else:
        _put_wide(memory, leaves, sixteens, exits, apart, places, trees, lanes)


@compiled
def _clear(memory: int, sixteens: int, copies: int, lanes: int) -> None:
    """Empties the sets of leaf numbers that only larger trees of a call have."""
    size = 8 * lanes
    unions = _UNIONS + 16 * ((sixteens + 15) // 16)
    for place in range(memory + size * _UNIONS_OF_4096, memory + size * unions, 8):
        store(place, 0)
    for copy in range(copies):
        start = memory + size * (_LEAVES + _APART * copy)
        for place in range(start, start + size * 16 * max(sixteens, _IN_REGISTERS), 8):
            store(place, 0)
