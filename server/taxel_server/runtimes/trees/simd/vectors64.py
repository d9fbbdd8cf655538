"""Vectors of 64-bit words as addresses: eight trees' memory read at once, eight bytes of each.

All of these run on any processor; without an instruction that gathers, LLVM loads lane by lane.
Addresses are plain integers: nothing checks bounds.
"""

from typing import Final

from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic

from taxel_server.runtimes.compiled.vectors import FloatVector, Vector, llvm_type, spread

_BIT: Final = ir.IntType(1)
_WORD: Final = ir.IntType(64)


@intrinsic
def widen(_context, vector):  # type: ignore[no-untyped-def]
    """Unsigned integers as words."""
    result = Vector(64, vector.lanes)

    def generate(_context, builder, _signature, arguments):  # type: ignore[no-untyped-def]
        return builder.zext(arguments[0], llvm_type(result))

    return result(vector), generate


@intrinsic(prefer_literal=True)
def elements(_context, _start, places, size):  # type: ignore[no-untyped-def]
    """The addresses of some elements behind a start, each of so many bytes, a power of two."""
    shift = size.literal_value.bit_length() - 1

    def generate(_context, builder, _signature, arguments):  # type: ignore[no-untyped-def]
        offset = builder.shl(arguments[1], ir.Constant(llvm_type(places), [shift] * places.lanes))
        return builder.add(spread(builder, arguments[0], places.lanes), offset)

    return places(types.intp, places, size), generate


@intrinsic(prefer_literal=True)
def bytes_at(_context, addresses, offset):  # type: ignore[no-untyped-def]
    """Eight bytes from each address and an offset, side by side."""
    result = Vector(8, 8 * addresses.lanes)

    def generate(_context, builder, _signature, arguments):  # type: ignore[no-untyped-def]
        kind = llvm_type(addresses)
        shifted = builder.add(arguments[0], ir.Constant(kind, [offset.literal_value] * addresses.lanes))
        return builder.bitcast(_gather(builder, shifted, _WORD, 8), llvm_type(result))

    return result(addresses, offset), generate


@intrinsic
def words_at(_context, addresses):  # type: ignore[no-untyped-def]
    """The word at each address."""

    def generate(_context, builder, _signature, arguments):  # type: ignore[no-untyped-def]
        return _gather(builder, arguments[0], _WORD, 8)

    return addresses(addresses), generate


@intrinsic
def floats_at(_context, addresses):  # type: ignore[no-untyped-def]
    """The float32 at each address."""
    result = FloatVector(addresses.lanes)

    def generate(_context, builder, _signature, arguments):  # type: ignore[no-untyped-def]
        return _gather(builder, arguments[0], ir.FloatType(), 4)

    return result(addresses), generate


@intrinsic
def lowest_common_bit(_context, sets):  # type: ignore[no-untyped-def]
    """Of each eight bytes, the number of the lowest bit that is set in all of them, which must exist."""
    result = Vector(64, sets.lanes // 8)

    def generate(_context, builder, _signature, arguments):  # type: ignore[no-untyped-def]
        kind = llvm_type(result)
        word = builder.bitcast(arguments[0], kind)
        for half in (32, 16, 8):
            shifted = builder.lshr(word, ir.Constant(kind, [half] * result.lanes))
            word = builder.and_(word, shifted)
        count = _declare(builder, f"llvm.cttz.v{result.lanes}i64", ir.FunctionType(kind, [kind, _BIT]))
        return builder.call(count, [word, _BIT(1)])

    return result(sets), generate


def _gather(builder: ir.IRBuilder, addresses: ir.Value, element: ir.Type, align: int) -> ir.Value:
    lanes = addresses.type.count
    pointers = ir.VectorType(ir.PointerType(), lanes)
    result, mask = ir.VectorType(element, lanes), ir.VectorType(_BIT, lanes)
    number = ir.IntType(32)
    kind = ir.FunctionType(result, [pointers, number, mask, result])
    name = f"llvm.masked.gather.v{lanes}{'i64' if element == _WORD else 'f32'}.v{lanes}p0"
    function = _declare(builder, name, kind)
    every = ir.Constant(mask, [1] * lanes)
    given = [builder.inttoptr(addresses, pointers), number(align), every, ir.Constant(result, ir.Undefined)]
    return builder.call(function, given)


def _declare(builder: ir.IRBuilder, name: str, kind: ir.FunctionType) -> ir.Function:
    return builder.module.declare_intrinsic(name, (), kind)
