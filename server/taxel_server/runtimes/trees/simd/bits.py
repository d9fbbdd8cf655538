"""Bitsets of rows: one instruction of the processor decides for hundreds of rows.

All operations run on any processor. Addresses are plain integers: nothing checks bounds.
"""

from functools import reduce
from typing import Any, Final

from llvmlite import ir
from numba import types

from taxel_server.runtimes.compiled.vectors import (
    Vector,
    broadcast,
    join,
    llvm_type,
    load_from,
    operation,
    take,
)

_INT64: Final = ir.IntType(64)
_HALVES: Final = ((4, 0x0F0F0F0F0F0F0F0F), (2, 0x3333333333333333), (1, 0x5555555555555555))


@operation
def not_below(_context: Any, _values: Any, _cut: Any, literal_missing_too: Any) -> Any:
    """A bit for each of 64 float32 values: whether it is at least the cut, or NaN if that counts, too."""

    def generate(_context: Any, builder: Any, _signature: Any, given: Any) -> Any:
        values = load_from(builder, given[0], ir.VectorType(ir.FloatType(), 64), 4)
        compare = builder.fcmp_unordered if literal_missing_too.literal_value else builder.fcmp_ordered
        return builder.bitcast(compare(">=", values, broadcast(builder, given[1], 64)), _INT64)

    return types.int64(types.intp, types.float32, literal_missing_too), generate


@operation
def number(_context: Any, _sets: Any, literal_count: Any, literal_lanes: Any) -> Any:
    """The number of each row's set among disjoint sets in memory.

    Returns:
        One bitset for each bit of the number, the lowest bit first, and the union of all sets.
    """
    vector = Vector(64, literal_lanes.literal_value)
    count = literal_count.literal_value
    bits = (count - 1).bit_length()

    def generate(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        kind = llvm_type(vector)
        first = builder.inttoptr(given[0], kind.as_pointer())
        places = [builder.gep(first, [_INT64(at)], source_etype=kind) for at in range(count)]
        sets = [builder.load(place, align=8, typ=kind) for place in places]
        found = []
        for _ in range(bits):
            found.append(reduce(builder.or_, sets[1::2]))
            sets = [reduce(builder.or_, sets[at : at + 2]) for at in range(0, len(sets), 2)]
        return context.make_tuple(builder, signature.return_type, (*found, *sets))

    return types.UniTuple(vector, bits + 1)(types.intp, literal_count, literal_lanes), generate


@operation
def put_numbers(_context: Any, bits: Any, _exits: Any, _places: Any, literal_trees: Any) -> Any:
    """Writes every row's number as a byte.

    Each vector of `bits` holds one bit of the numbers, the lowest first, at most 8 of them. A vector holds
    the rows of `literal_trees` trees. A tree's place, eight bytes in memory, tells where its exits begin,
    in multiples of its rows. Of r rows, row 8 j + k goes to k r / 8 + j: this order needs no sorting.
    """
    trees = literal_trees.literal_value
    share = bits.dtype.lanes // trees

    def generate(context: Any, builder: Any, _signature: Any, given: Any) -> Any:
        vectors = [builder.extract_value(given[0], place) for place in range(bits.count)]
        none = [ir.Constant(vectors[0].type, [0] * bits.dtype.lanes)] * (8 - bits.count)
        numbers = _transpose(builder, [*vectors, *none])
        for tree in range(trees):
            place = load_from(builder, builder.add(given[2], _INT64(8 * tree)), _INT64, 8)
            address = builder.add(given[1], builder.mul(place, _INT64(64 * share)))
            lanes = range(tree * share, (tree + 1) * share)
            joined = join(builder, [take(builder, vector, lanes) for vector in numbers])
            builder.store(joined, builder.inttoptr(address, joined.type.as_pointer()), align=1)
        return context.get_dummy_value()

    return types.void(bits, types.intp, types.intp, literal_trees), generate


def _transpose(builder: ir.IRBuilder, vectors: list[ir.Value]) -> list[ir.Value]:
    """In every byte, swaps bit i of vector k with bit k of vector i: by halves, quarters, then eighths."""
    lanes = vectors[0].type.count
    for distance, low in _HALVES:
        shift, mask = (ir.Constant(vectors[0].type, [value] * lanes) for value in (distance, low))
        for upper in (place for place in range(8) if not place & distance):
            lower = upper + distance
            high = builder.lshr(vectors[upper], shift)
            change = builder.and_(builder.xor(high, vectors[lower]), mask)
            vectors[lower] = builder.xor(vectors[lower], change)
            vectors[upper] = builder.xor(vectors[upper], builder.shl(change, shift))
    return vectors
