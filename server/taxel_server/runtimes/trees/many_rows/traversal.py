"""Evaluates many rows at once: every node splits the set of rows that reach it, as a vector of bits."""

from functools import cache
from typing import Final

import numba

from taxel_server.runtimes.compiled.compiling import address_of, inlined
from taxel_server.runtimes.compiled.vectors import AHEAD, integer_at, load, prefetch, splat, store
from taxel_server.runtimes.trees.layout.bitsets import GROUP, RECORDS
from taxel_server.runtimes.trees.simd.bits import common, either, number, put_numbers, without
from taxel_server.runtimes.trees.simd.vectors64 import elements, widen, words_at

_SIGNATURE: Final = "void(intp, intp, intp, intp, intp, intp, intp, intp, intp, intp)"

_GROUP: Final = GROUP.itemsize

_UNION: Final = 16
_UNIONS_OF_4096: Final = _UNION + 1
_UNIONS_OF_256: Final = _UNIONS_OF_4096 + 16
_UNIONS: Final = _UNIONS_OF_256 + 256
_LEAVES: Final = _UNIONS + 4096
"""Where in a kernel's memory, in sets, each leaf number's is; the unions of 16, 256, 4096 and all of them.

The 16 sets before are the bits of every row's leaf number.
"""

_APART: Final = 256
"""How many sets one tree's are from the next's, where four trees of 256 rows are visited at once."""

_IN_REGISTERS: Final = 4
"""Sixteens of leaves whose rows are numbered without a detour through memory."""


def memory_words(numbers: int) -> int:
    """How many 64-bit words of memory, all zero, trees of so many leaf numbers need."""
    return (_LEAVES + max(numbers + 16, 2 * _APART)) * 8


@inlined
def _split_at(place, goes_right, new, words):  # type: ignore[no-untyped-def]
    """Splits a set of rows: the left child keeps its place, the right one gets a new one."""
    rows = load(place, 64, words)
    right = common(rows, goes_right)
    store(place, without(rows, right))
    store(new, right)


@inlined
def _split(node, bits, comparisons, leaves, scale, new, words):  # type: ignore[no-untyped-def]
    """Splits the rows that reach a node, whose record is two numbers of so many bits."""
    goes_right = load(comparisons + 8 * words * integer_at(node, bits), 64, words)
    _split_at(leaves + scale * integer_at(node + bits // 8, bits), goes_right, new, words)


@inlined
def _number_by_sixteens(sets, sixteens, unions, bits, words):  # type: ignore[no-untyped-def]
    """Four bits of the number of the set that each row is in; the sets' unions by sixteens."""
    bit0 = splat(0, 64, words)
    bit1 = bit0
    bit2 = bit0
    bit3 = bit0
    for sixteen in range(sixteens):
        found = number(sets + 128 * words * sixteen, 16, words)
        bit0 = either(bit0, found[0])
        bit1 = either(bit1, found[1])
        bit2 = either(bit2, found[2])
        bit3 = either(bit3, found[3])
        store(unions + 8 * words * sixteen, found[4])
    store(bits, bit0)
    store(bits + 8 * words, bit1)
    store(bits + 16 * words, bit2)
    store(bits + 24 * words, bit3)


@inlined
def _put_bits(bits, addresses, words):  # type: ignore[no-untyped-def]
    eight = (
        load(bits, 64, words),
        load(bits + 8 * words, 64, words),
        load(bits + 16 * words, 64, words),
        load(bits + 24 * words, 64, words),
        load(bits + 32 * words, 64, words),
        load(bits + 40 * words, 64, words),
        load(bits + 48 * words, 64, words),
        load(bits + 56 * words, 64, words),
    )
    put_numbers(eight, addresses)


@inlined
def _put_narrow(memory, leaves, sixteens, addresses, words):  # type: ignore[no-untyped-def]
    """Writes the number of the leaf that each row reached, a byte."""
    if sixteens <= 2:
        put_numbers(number(leaves, 32, words)[:-1], addresses)
    elif sixteens == 3:
        put_numbers(number(leaves, 48, words)[:-1], addresses)
    elif sixteens == 4:
        put_numbers(number(leaves, 64, words)[:-1], addresses)
    else:
        size = 8 * words
        _number_by_sixteens(leaves, sixteens, memory + size * _UNIONS, memory, words)
        _number_by_sixteens(
            memory + size * _UNIONS, 1, memory + size * _UNIONS_OF_256, memory + 4 * size, words
        )
        _put_bits(memory, addresses, words)


@inlined
def _number_wide(memory, sixteens, words):  # type: ignore[no-untyped-def]
    """Sixteen bits of the number of the leaf that each row reached."""
    size = 8 * words
    unions, unions256 = memory + size * _UNIONS, memory + size * _UNIONS_OF_256
    unions4096, union = memory + size * _UNIONS_OF_4096, memory + size * _UNION
    _number_by_sixteens(memory + size * _LEAVES, sixteens, unions, memory, words)
    sixteens = (sixteens + 15) // 16
    _number_by_sixteens(unions, sixteens, unions256, memory + 4 * size, words)
    sixteens = (sixteens + 15) // 16
    _number_by_sixteens(unions256, sixteens, unions4096, memory + 8 * size, words)
    _number_by_sixteens(unions4096, 1, union, memory + 12 * size, words)


@numba.njit
def _clear(memory, sixteens, apart, words):  # type: ignore[no-untyped-def]
    """Empties the sets of leaf numbers that a call's smaller trees do not have."""
    size = 8 * words
    for place in range(_UNIONS_OF_4096, _UNIONS + 16 * ((sixteens + 15) // 16)):
        store(memory + size * place, splat(0, 64, words))
    for place in range(_LEAVES, _LEAVES + 16 * max(sixteens, _IN_REGISTERS)):
        for member in range(4 if apart else 1):
            store(memory + size * (apart * member + place), splat(0, 64, words))


@cache
def find_exits(bytes_: int, lanes: int) -> int:
    """The address of the traversal of some groups by a block of 64 or 256 rows, compiled.

    The function takes the number of groups, the addresses of the first group and of all records; the
    number of places in full levels and the address of the sets split there (`split_sets`); then
    the addresses of the block's comparisons [comparison][row], a bit each, of the memory, and of the
    block's exits [place][byte][lane], which it writes; at last what it asks for meanwhile: an address,
    and bytes for every group. Row 8 j + k goes to lane k lanes / 8 + j.
    """
    if bytes_ == 1:
        return _eight_trees_in_a_vector() if lanes == 64 else _four_trees_in_turn()
    return _four_trees_in_a_vector() if lanes == 64 else _one_tree_after_another()


@inlined
def _ask_ahead(records, size, later, each):  # type: ignore[no-untyped-def]
    """Asks for the records that come after a group's, and for what is wanted when all groups are done."""
    for line in range(AHEAD, AHEAD + size, 64):
        prefetch(records + line, 1)
    for line in range(0, each, 64):
        prefetch(later + line, 2)


def _eight_trees_in_a_vector() -> int:
    size = RECORDS[1].itemsize

    @address_of(_SIGNATURE)
    def traverse(count, groups, records, full, sets, comparisons, memory, exits, later, each):  # type: ignore[no-untyped-def]
        _clear(memory, integer_at(groups + _GROUP * (count - 1) + 16, 64), 0, 8)
        leaves = memory + 64 * _LEAVES
        for _ in range(count):
            node, new = records + integer_at(groups, 64), leaves
            steps, sixteens = integer_at(groups + 8, 64), integer_at(groups + 16, 64)
            _ask_ahead(node, 16 * full + 8 * size * steps, later, each)
            store(leaves, splat(-1, 64, 8))
            for place in range(full):
                new += 64
                goes_right = words_at(elements(comparisons, widen(load(node, 16, 8)), 8))
                _split_at(leaves + 2 * integer_at(sets + 8 * place, 64), goes_right, new, 8)
                node += 16
            for _step in range(steps):
                new += 64
                _split(node, 16, comparisons, leaves, 2, new, 1)
                _split(node + size, 16, comparisons, leaves + 8, 2, new + 8, 1)
                _split(node + 2 * size, 16, comparisons, leaves + 16, 2, new + 16, 1)
                _split(node + 3 * size, 16, comparisons, leaves + 24, 2, new + 24, 1)
                _split(node + 4 * size, 16, comparisons, leaves + 32, 2, new + 32, 1)
                _split(node + 5 * size, 16, comparisons, leaves + 40, 2, new + 40, 1)
                _split(node + 6 * size, 16, comparisons, leaves + 48, 2, new + 48, 1)
                _split(node + 7 * size, 16, comparisons, leaves + 56, 2, new + 56, 1)
                node += 8 * size
            trees = (
                exits + integer_at(groups + 24, 64) * 64,
                exits + integer_at(groups + 32, 64) * 64,
                exits + integer_at(groups + 40, 64) * 64,
                exits + integer_at(groups + 48, 64) * 64,
                exits + integer_at(groups + 56, 64) * 64,
                exits + integer_at(groups + 64, 64) * 64,
                exits + integer_at(groups + 72, 64) * 64,
                exits + integer_at(groups + 80, 64) * 64,
            )
            _put_narrow(memory, leaves, sixteens, trees, 8)
            groups += _GROUP
            later += each

    return traverse


@inlined
def _split_full(node, comparisons, leaves, at, new):  # type: ignore[no-untyped-def]
    """Splits the rows of one tree at a place of its full levels."""
    goes_right = load(comparisons + 32 * integer_at(node, 16), 64, 4)
    _split_at(leaves + at, goes_right, leaves + new, 4)


def _four_trees_in_turn() -> int:
    size = RECORDS[1].itemsize

    @address_of(_SIGNATURE)
    def traverse(count, groups, records, full, sets, comparisons, memory, exits, later, each):  # type: ignore[no-untyped-def]
        _clear(memory, integer_at(groups + _GROUP * (count - 1) + 16, 64), _APART, 4)
        leaves0 = memory + 32 * _LEAVES
        leaves1 = leaves0 + 32 * _APART
        leaves2 = leaves1 + 32 * _APART
        leaves3 = leaves2 + 32 * _APART
        for _ in range(count):
            first = records + integer_at(groups, 64)
            steps, sixteens = integer_at(groups + 8, 64), integer_at(groups + 16, 64)
            _ask_ahead(first, full * 16 + 8 * size * steps, later, each)
            for half in range(2):
                node, new = first + 8 * half, 0
                for member in range(4):
                    store(leaves0 + 32 * _APART * member, splat(-1, 64, 4))
                for place in range(full):
                    new += 32
                    at = integer_at(sets + 8 * place, 64)
                    _split_full(node, comparisons, leaves0, at, new)
                    _split_full(node + 2, comparisons, leaves1, at, new)
                    _split_full(node + 4, comparisons, leaves2, at, new)
                    _split_full(node + 6, comparisons, leaves3, at, new)
                    node += 16
                node = first + 16 * full + 4 * size * half
                for _step in range(steps):
                    new += 32
                    _split(node, 16, comparisons, leaves0, 1, leaves0 + new, 4)
                    _split(node + size, 16, comparisons, leaves1, 1, leaves1 + new, 4)
                    _split(node + 2 * size, 16, comparisons, leaves2, 1, leaves2 + new, 4)
                    _split(node + 3 * size, 16, comparisons, leaves3, 1, leaves3 + new, 4)
                    node += 8 * size
                for member in range(4):
                    place = exits + integer_at(groups + 24 + 32 * half + 8 * member, 64) * 256
                    _put_narrow(memory, leaves0 + 32 * _APART * member, sixteens, (place,), 4)
            groups += _GROUP
            later += each

    return traverse


def _four_trees_in_a_vector() -> int:
    size = RECORDS[2].itemsize

    @address_of(_SIGNATURE)
    def traverse(count, groups, records, _full, _sets, comparisons, memory, exits, later, each):  # type: ignore[no-untyped-def]
        _clear(memory, integer_at(groups + _GROUP * (count - 1) + 16, 64), 0, 4)
        leaves = memory + 32 * _LEAVES
        for _ in range(count):
            node, new = records + integer_at(groups, 64), leaves
            steps = integer_at(groups + 8, 64)
            _ask_ahead(node, 4 * size * steps, later, each)
            store(leaves, splat(-1, 64, 4))
            for _step in range(steps):
                new += 32
                _split(node, 32, comparisons, leaves, 1, new, 1)
                _split(node + size, 32, comparisons, leaves + 8, 1, new + 8, 1)
                _split(node + 2 * size, 32, comparisons, leaves + 16, 1, new + 16, 1)
                _split(node + 3 * size, 32, comparisons, leaves + 24, 1, new + 24, 1)
                node += 4 * size
            tree0 = exits + integer_at(groups + 24, 64) * 64
            tree1 = exits + integer_at(groups + 32, 64) * 64
            tree2 = exits + integer_at(groups + 40, 64) * 64
            tree3 = exits + integer_at(groups + 48, 64) * 64
            _number_wide(memory, integer_at(groups + 16, 64), 4)
            _put_bits(memory, (tree0, tree1, tree2, tree3), 4)
            _put_bits(memory + 8 * 32, (tree0 + 64, tree1 + 64, tree2 + 64, tree3 + 64), 4)
            groups += _GROUP
            later += each

    return traverse


def _one_tree_after_another() -> int:
    size = RECORDS[2].itemsize

    @address_of(_SIGNATURE)
    def traverse(count, groups, records, _full, _sets, comparisons, memory, exits, later, each):  # type: ignore[no-untyped-def]
        _clear(memory, integer_at(groups + _GROUP * (count - 1) + 16, 64), 0, 4)
        leaves = memory + 32 * _LEAVES
        for _ in range(count):
            _ask_ahead(records + integer_at(groups, 64), 4 * size * integer_at(groups + 8, 64), later, each)
            for member in range(4):
                node, new = records + integer_at(groups, 64) + size * member, leaves
                store(leaves, splat(-1, 64, 4))
                for _step in range(integer_at(groups + 8, 64)):
                    new += 32
                    _split(node, 32, comparisons, leaves, 1, new, 4)
                    node += 4 * size
                _number_wide(memory, integer_at(groups + 16, 64), 4)
                place = exits + integer_at(groups + 24 + 8 * member, 64) * 256
                _put_bits(memory, (place,), 4)
                _put_bits(memory + 8 * 32, (place + 256,), 4)
            groups += _GROUP
            later += each

    return traverse
