"""Evaluates many rows at once: every node splits the set of rows that reach it, as a vector of bits."""

from functools import cache
from typing import Final

import numba

from taxel_server.runtimes.trees.bits import common, either, number, put_numbers, without
from taxel_server.runtimes.trees.rows_layout import GROUP, RECORDS, SET_BYTES
from taxel_server.runtimes.trees.vectors import integer_at, load, splat, store

_SIGNATURE: Final = "void(intp, intp, intp, intp, intp, intp)"

_WORDS: Final = SET_BYTES // 8
"""64-bit words of a set: those of one tree's 256 rows, or one of each of four trees' 64."""

_GROUP: Final = GROUP.itemsize

_UNION: Final = 16 * SET_BYTES
_UNIONS_OF_4096: Final = _UNION + SET_BYTES
_UNIONS_OF_256: Final = _UNIONS_OF_4096 + 16 * SET_BYTES
_UNIONS: Final = _UNIONS_OF_256 + 256 * SET_BYTES
_LEAVES: Final = _UNIONS + 4096 * SET_BYTES
"""Where in a kernel's memory each leaf's set of rows is, and the unions of 16, 256, 4096 and all of them.

The 16 sets before are the bits of every row's leaf number.
"""

_APART: Final = 260 * SET_BYTES
"""How far one tree's sets are from the next's, where four trees of 256 rows are visited at once."""

_IN_REGISTERS: Final = 4
"""Sixteens of leaves whose rows are numbered without a detour through memory."""


def memory_words(leaves: int) -> int:
    """How many 64-bit words of memory, all zero, trees of so many leaves need."""
    return (_LEAVES + max((leaves + 16) * SET_BYTES, 4 * _APART)) // 8


@numba.njit(inline="always")
def _split(node, bits, comparisons, leaves, new, words):  # type: ignore[no-untyped-def]
    """Splits the rows that reach a node: its left child keeps their place, its right one gets a new one.

    A record is two numbers of so many bits.
    """
    goes_right = load(comparisons + 8 * words * integer_at(node, bits), 64, words)
    place = leaves + integer_at(node + bits // 8, bits)
    rows = load(place, 64, words)
    right = common(rows, goes_right)
    store(place, without(rows, right))
    store(new, right)


@numba.njit(inline="always")
def _number_by_sixteens(sets, sixteens, unions, bits):  # type: ignore[no-untyped-def]
    """Four bits of the number of the set that each row is in; the sets' unions by sixteens."""
    bit0 = splat(0, 64, _WORDS)
    bit1 = bit0
    bit2 = bit0
    bit3 = bit0
    for sixteen in range(sixteens):
        found = number(sets + 16 * SET_BYTES * sixteen, 16, _WORDS)
        bit0 = either(bit0, found[0])
        bit1 = either(bit1, found[1])
        bit2 = either(bit2, found[2])
        bit3 = either(bit3, found[3])
        store(unions + SET_BYTES * sixteen, found[4])
    store(bits, bit0)
    store(bits + SET_BYTES, bit1)
    store(bits + 2 * SET_BYTES, bit2)
    store(bits + 3 * SET_BYTES, bit3)


@numba.njit(inline="always")
def _put_bits(bits, addresses):  # type: ignore[no-untyped-def]
    eight = (
        load(bits, 64, _WORDS),
        load(bits + SET_BYTES, 64, _WORDS),
        load(bits + 2 * SET_BYTES, 64, _WORDS),
        load(bits + 3 * SET_BYTES, 64, _WORDS),
        load(bits + 4 * SET_BYTES, 64, _WORDS),
        load(bits + 5 * SET_BYTES, 64, _WORDS),
        load(bits + 6 * SET_BYTES, 64, _WORDS),
        load(bits + 7 * SET_BYTES, 64, _WORDS),
    )
    put_numbers(eight, addresses)


@numba.njit(inline="always")
def _put_narrow(memory, leaves, sixteens, addresses):  # type: ignore[no-untyped-def]
    """Writes the number of the leaf that each row reached, a byte."""
    if sixteens <= 2:
        put_numbers(number(leaves, 32, _WORDS)[:-1], addresses)
    elif sixteens == 3:
        put_numbers(number(leaves, 48, _WORDS)[:-1], addresses)
    elif sixteens == 4:
        put_numbers(number(leaves, 64, _WORDS)[:-1], addresses)
    else:
        _number_by_sixteens(leaves, sixteens, memory + _UNIONS, memory)
        _number_by_sixteens(memory + _UNIONS, 1, memory + _UNIONS_OF_256, memory + 4 * SET_BYTES)
        _put_bits(memory, addresses)


@numba.njit(inline="always")
def _number_wide(memory, sixteens):  # type: ignore[no-untyped-def]
    """Sixteen bits of the number of the leaf that each row reached."""
    _number_by_sixteens(memory + _LEAVES, sixteens, memory + _UNIONS, memory)
    sixteens = (sixteens + 15) // 16
    _number_by_sixteens(memory + _UNIONS, sixteens, memory + _UNIONS_OF_256, memory + 4 * SET_BYTES)
    sixteens = (sixteens + 15) // 16
    _number_by_sixteens(memory + _UNIONS_OF_256, sixteens, memory + _UNIONS_OF_4096, memory + 8 * SET_BYTES)
    _number_by_sixteens(memory + _UNIONS_OF_4096, 1, memory + _UNION, memory + 12 * SET_BYTES)


@numba.njit
def _clear(memory, sixteens, apart):  # type: ignore[no-untyped-def]
    """Empties the sets of leaves that a call's smaller trees do not have, and one behind them."""
    for place in range(_UNIONS_OF_4096, _UNIONS + SET_BYTES * 16 * ((sixteens + 15) // 16), SET_BYTES):
        store(memory + place, splat(0, 64, _WORDS))
    sets = 16 * max(sixteens, _IN_REGISTERS) + 1
    for place in range(_LEAVES, _LEAVES + sets * SET_BYTES, SET_BYTES):
        for member in range(4 if apart else 1):
            store(memory + apart * member + place, splat(0, 64, _WORDS))


@cache
def find_exits(bytes_: int, lanes: int) -> int:
    """The address of the traversal of some groups by a block of 64 or 256 rows, compiled.

    The function takes the number of groups and the addresses of the first group, all records, the
    block's comparisons [comparison][row], a bit each, the memory, and the block's exits
    [place][byte][lane], which it writes. Row 8 j + k goes to lane k lanes / 8 + j.
    """
    if lanes == 64:
        return _four_trees_in_a_vector(bytes_)
    return _four_trees_in_turn() if bytes_ == 1 else _one_tree_after_another()


def _four_trees_in_a_vector(bytes_: int) -> int:
    size, bits = RECORDS[bytes_].itemsize, 16 * bytes_

    @numba.cfunc(_SIGNATURE, cache=True)
    def traverse(count, groups, records, comparisons, memory, exits):  # type: ignore[no-untyped-def]
        _clear(memory, integer_at(groups + _GROUP * (count - 1) + 16, 64), 0)
        leaves = memory + _LEAVES
        for _ in range(count):
            node, new = records + size * integer_at(groups, 64), leaves
            store(leaves, splat(-1, 64, _WORDS))
            for _step in range(integer_at(groups + 8, 64)):
                new += SET_BYTES
                _split(node, bits, comparisons, leaves, new, 1)
                _split(node + size, bits, comparisons, leaves + 8, new + 8, 1)
                _split(node + 2 * size, bits, comparisons, leaves + 16, new + 16, 1)
                _split(node + 3 * size, bits, comparisons, leaves + 24, new + 24, 1)
                node += 4 * size
            first = exits + integer_at(groups + 24, 64) * 64
            second = exits + integer_at(groups + 32, 64) * 64
            third = exits + integer_at(groups + 40, 64) * 64
            fourth = exits + integer_at(groups + 48, 64) * 64
            if bytes_ == 1:
                _put_narrow(memory, leaves, integer_at(groups + 16, 64), (first, second, third, fourth))
            else:
                _number_wide(memory, integer_at(groups + 16, 64))
                _put_bits(memory, (first, second, third, fourth))
                upper = (first + 64, second + 64, third + 64, fourth + 64)
                _put_bits(memory + 8 * SET_BYTES, upper)
            groups += _GROUP

    return int(traverse.address)


def _four_trees_in_turn() -> int:
    size = RECORDS[1].itemsize

    @numba.cfunc(_SIGNATURE, cache=True)
    def traverse(count, groups, records, comparisons, memory, exits):  # type: ignore[no-untyped-def]
        _clear(memory, integer_at(groups + _GROUP * (count - 1) + 16, 64), _APART)
        leaves0 = memory + _LEAVES
        leaves1 = leaves0 + _APART
        leaves2 = leaves1 + _APART
        leaves3 = leaves2 + _APART
        for _ in range(count):
            node, new = records + size * integer_at(groups, 64), 0
            for member in range(4):
                store(leaves0 + _APART * member, splat(-1, 64, _WORDS))
            for _step in range(integer_at(groups + 8, 64)):
                new += SET_BYTES
                _split(node, 16, comparisons, leaves0, leaves0 + new, _WORDS)
                _split(node + size, 16, comparisons, leaves1, leaves1 + new, _WORDS)
                _split(node + 2 * size, 16, comparisons, leaves2, leaves2 + new, _WORDS)
                _split(node + 3 * size, 16, comparisons, leaves3, leaves3 + new, _WORDS)
                node += 4 * size
            for member in range(4):
                place = exits + integer_at(groups + 24 + 8 * member, 64) * 64 * _WORDS
                _put_narrow(memory, leaves0 + _APART * member, integer_at(groups + 16, 64), (place,))
            groups += _GROUP

    return int(traverse.address)


def _one_tree_after_another() -> int:
    size = RECORDS[2].itemsize

    @numba.cfunc(_SIGNATURE, cache=True)
    def traverse(count, groups, records, comparisons, memory, exits):  # type: ignore[no-untyped-def]
        _clear(memory, integer_at(groups + _GROUP * (count - 1) + 16, 64), 0)
        leaves = memory + _LEAVES
        for _ in range(count):
            for member in range(4):
                node, new = records + size * (integer_at(groups, 64) + member), leaves
                store(leaves, splat(-1, 64, _WORDS))
                for _step in range(integer_at(groups + 8, 64)):
                    new += SET_BYTES
                    _split(node, 32, comparisons, leaves, new, _WORDS)
                    node += 4 * size
                _number_wide(memory, integer_at(groups + 16, 64))
                place = exits + integer_at(groups + 24 + 8 * member, 64) * 64 * _WORDS
                _put_bits(memory, (place,))
                _put_bits(memory + 8 * SET_BYTES, (place + 64 * _WORDS,))
            groups += _GROUP

    return int(traverse.address)
