"""Sets of rows as vectors of bits: one operation of the processor decides for hundreds of rows.

All of these run on any processor. Addresses are plain integers: nothing checks bounds.
"""

from typing import Final

from llvmlite import ir
from numba.core import cgutils, types
from numba.core.types.containers import UniTuple
from numba.extending import intrinsic

from taxel_server.runtimes.compiled.vectors import Vector, join, lane_numbers, llvm_type, take

_WORD: Final = ir.IntType(64)
_HALVES: Final = ((4, 0x0F0F0F0F0F0F0F0F), (2, 0x3333333333333333), (1, 0x5555555555555555))


@intrinsic
def common(_context, left, right):  # type: ignore[no-untyped-def]
    """The rows in both of two sets."""

    def generate(_context, builder, _signature, arguments):  # type: ignore[no-untyped-def]
        return builder.and_(*arguments)

    return left(left, right), generate


@intrinsic
def either(_context, left, right):  # type: ignore[no-untyped-def]
    """The rows in one of two sets or in both."""

    def generate(_context, builder, _signature, arguments):  # type: ignore[no-untyped-def]
        return builder.or_(*arguments)

    return left(left, right), generate


@intrinsic
def without(_context, rows, some):  # type: ignore[no-untyped-def]
    """The rows of a set but for some of them."""

    def generate(_context, builder, _signature, arguments):  # type: ignore[no-untyped-def]
        return builder.xor(*arguments)

    return rows(rows, some), generate


@intrinsic(prefer_literal=True)
def not_below(_context, _values, _cut, missing_too):  # type: ignore[no-untyped-def]
    """Which of 64 float32 values in memory are at least the cut or, if `missing_too`, NaN."""

    def generate(_context, builder, _signature, arguments):  # type: ignore[no-untyped-def]
        values = ir.VectorType(ir.FloatType(), 64)
        pointer = builder.inttoptr(arguments[0], values.as_pointer())
        one = builder.insert_element(ir.Constant(values, ir.Undefined), arguments[1], ir.IntType(32)(0))
        cut = builder.shuffle_vector(one, one, lane_numbers([0] * 64))
        compare = builder.fcmp_unordered if missing_too.literal_value else builder.fcmp_ordered
        return builder.bitcast(compare(">=", builder.load(pointer, align=4, typ=values), cut), _WORD)

    return types.int64(types.intp, types.float32, missing_too), generate


@intrinsic(prefer_literal=True)
def number(_context, _sets, count, words):  # type: ignore[no-untyped-def]
    """Which of so many disjoint sets in memory a row is in: the bits of its number, and the sets' union.

    The rows with the lowest bit set come first.
    """
    vector = Vector(64, words.literal_value)
    bits = (count.literal_value - 1).bit_length()

    def generate(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
        kind = llvm_type(vector)
        first = builder.inttoptr(arguments[0], kind.as_pointer())
        places = [builder.gep(first, [_WORD(at)], source_etype=kind) for at in range(count.literal_value)]
        sets = [builder.load(place, align=8, typ=kind) for place in places]
        found = []
        for _ in range(bits):
            found.append(_union(builder, sets[1::2]))
            sets = [_union(builder, sets[at : at + 2]) for at in range(0, len(sets), 2)]
        return context.make_tuple(builder, signature.return_type, (*found, *sets))

    return UniTuple(vector, bits + 1)(types.intp, count, words), generate


@intrinsic
def put_numbers(_context, bits, addresses):  # type: ignore[no-untyped-def]
    """Writes every row's number as a byte, from the rows with its lowest bit set, the next, at most 8.

    Each of the addresses gets its share of the words' rows: of r rows, number 8 j + k goes to place
    k r / 8 + j, which needs no sorting.
    """

    def generate(context, builder, _signature, arguments):  # type: ignore[no-untyped-def]
        given = cgutils.unpack_tuple(builder, arguments[0], bits.count)
        none = [ir.Constant(given[0].type, [0] * bits.dtype.lanes)] * (8 - bits.count)
        numbers = _transpose(builder, [*given, *none])
        share = bits.dtype.lanes // addresses.count
        for place, address in enumerate(cgutils.unpack_tuple(builder, arguments[1], addresses.count)):
            lanes = range(place * share, (place + 1) * share)
            joined = join(builder, [take(builder, vector, lanes) for vector in numbers])
            builder.store(joined, builder.inttoptr(address, joined.type.as_pointer()), align=1)
        return context.get_dummy_value()

    return types.void(bits, addresses), generate


def _union(builder: ir.IRBuilder, sets: list[ir.Value]) -> ir.Value:
    first, *others = sets
    for other in others:
        first = builder.or_(first, other)
    return first


def _transpose(builder: ir.IRBuilder, vectors: list[ir.Value]) -> list[ir.Value]:
    """Exchanges, in every byte, bit i of vector k with bit k of vector i: by halves, quarters, eighths."""
    vectors = list(vectors)
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
