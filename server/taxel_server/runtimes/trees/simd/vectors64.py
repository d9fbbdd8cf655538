"""Vectors of 64-bit integers and addresses: they read the memory of eight trees at once.

All operations run on any processor. Without a gather instruction, LLVM loads lane by lane.
Addresses are plain integers: nothing checks bounds.
"""

from typing import Any, Final

from llvmlite import ir
from numba import types

from taxel_server.runtimes.compiled.vectors import (
    FloatVector,
    Vector,
    broadcast,
    declare,
    llvm_type,
    operation,
)

_BIT: Final = ir.IntType(1)
_INT64: Final = ir.IntType(64)


@operation
def widen(_context: Any, vector: Any) -> Any:
    """Unsigned integers as 64-bit ones."""
    result = Vector(64, vector.lanes)

    def generate(_context: Any, builder: Any, _signature: Any, given: Any) -> Any:
        return builder.zext(given[0], llvm_type(result))

    return result(vector), generate


@operation
def elements(_context: Any, _start: Any, places: Any, literal_size: Any) -> Any:
    """The addresses of elements behind a start. An element has `literal_size` bytes, a power of two."""
    shift = literal_size.literal_value.bit_length() - 1

    def generate(_context: Any, builder: Any, _signature: Any, given: Any) -> Any:
        offset = builder.shl(given[1], ir.Constant(llvm_type(places), [shift] * places.lanes))
        return builder.add(broadcast(builder, given[0], places.lanes), offset)

    return places(types.intp, places, literal_size), generate


@operation
def bytes_at(_context: Any, addresses: Any, literal_offset: Any) -> Any:
    """Eight bytes at each address plus an offset, side by side."""
    result = Vector(8, 8 * addresses.lanes)

    def generate(_context: Any, builder: Any, _signature: Any, given: Any) -> Any:
        offset = ir.Constant(llvm_type(addresses), [literal_offset.literal_value] * addresses.lanes)
        found = _gather(builder, builder.add(given[0], offset), _INT64, 8)
        return builder.bitcast(found, llvm_type(result))

    return result(addresses, literal_offset), generate


@operation
def int64s_at(_context: Any, addresses: Any) -> Any:
    """The 64-bit integer at each address."""

    def generate(_context: Any, builder: Any, _signature: Any, given: Any) -> Any:
        return _gather(builder, given[0], _INT64, 8)

    return addresses(addresses), generate


@operation
def floats_at(_context: Any, addresses: Any) -> Any:
    """The float32 at each address."""

    def generate(_context: Any, builder: Any, _signature: Any, given: Any) -> Any:
        return _gather(builder, given[0], ir.FloatType(), 4)

    return FloatVector(addresses.lanes)(addresses), generate


@operation
def lowest_common_bit(_context: Any, sets: Any) -> Any:
    """For each eight bytes, the number of the lowest bit that all of them have set. It must exist."""
    result = Vector(64, sets.lanes // 8)

    def generate(_context: Any, builder: Any, _signature: Any, given: Any) -> Any:
        kind = llvm_type(result)
        value = builder.bitcast(given[0], kind)
        for half in (32, 16, 8):
            shifted = builder.lshr(value, ir.Constant(kind, [half] * result.lanes))
            value = builder.and_(value, shifted)
        count = declare(builder, f"llvm.cttz.v{result.lanes}i64", kind, [kind, _BIT])
        return builder.call(count, [value, _BIT(1)])

    return result(sets), generate


def _gather(builder: ir.IRBuilder, addresses: ir.Value, element: ir.Type, align: int) -> ir.Value:
    lanes = addresses.type.count
    pointers, number = ir.VectorType(ir.PointerType(), lanes), ir.IntType(32)
    result, mask = ir.VectorType(element, lanes), ir.VectorType(_BIT, lanes)
    name = f"llvm.masked.gather.v{lanes}{'i64' if element == _INT64 else 'f32'}.v{lanes}p0"
    function = declare(builder, name, result, [pointers, number, mask, result])
    every, none = ir.Constant(mask, [1] * lanes), ir.Constant(result, ir.Undefined)
    return builder.call(function, [builder.inttoptr(addresses, pointers), number(align), every, none])
