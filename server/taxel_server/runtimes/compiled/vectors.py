"""SIMD vectors as a numba type, and the few operations on them that the kernels need.

A `Vector` is an LLVM vector of integers that lives in an ordinary variable of a compiled function.
All of these run on any processor; LLVM splits lanes beyond a register's. Addresses are plain
integers: nothing checks bounds.
"""

from collections.abc import Iterable
from typing import Any, Final

from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic, models, register_model

AHEAD: Final = 4096
"""Bytes by which a stream is asked for ahead: the processor by itself does not look beyond a page."""

_BYTE: Final = ir.IntType(8)
_WORD: Final = ir.IntType(64)


class Vector(types.Type):
    """Integers of `bits` bits in `lanes` lanes; a mask has one bit a lane."""

    def __init__(self, bits: int, lanes: int) -> None:
        self.bits = bits
        self.lanes = lanes
        super().__init__(name=f"Vector(int{bits} x {lanes})")


class FloatVector(types.Type):
    """Float32 values in `lanes` lanes."""

    def __init__(self, lanes: int) -> None:
        self.lanes = lanes
        super().__init__(name=f"Vector(float32 x {lanes})")


@register_model(Vector)
class _VectorModel(models.PrimitiveModel):  # type: ignore[misc]
    def __init__(self, manager: Any, vector: Vector) -> None:
        super().__init__(manager, vector, llvm_type(vector))


@register_model(FloatVector)
class _FloatVectorModel(models.PrimitiveModel):  # type: ignore[misc]
    def __init__(self, manager: Any, vector: FloatVector) -> None:
        super().__init__(manager, vector, llvm_type(vector))


def llvm_type(vector: Vector | FloatVector) -> ir.VectorType:
    """What LLVM calls a vector's type."""
    if isinstance(vector, FloatVector):
        return ir.VectorType(ir.FloatType(), vector.lanes)
    return ir.VectorType(ir.IntType(vector.bits), vector.lanes)


@intrinsic(prefer_literal=True)
def load(_context, _address, bits, lanes):  # type: ignore[no-untyped-def]
    """Reads a vector from memory, at any alignment."""
    vector = Vector(bits.literal_value, lanes.literal_value)

    def generate(_context, builder, _signature, arguments):  # type: ignore[no-untyped-def]
        pointer = builder.inttoptr(arguments[0], llvm_type(vector).as_pointer())
        return builder.load(pointer, align=1, typ=llvm_type(vector))

    return vector(types.intp, bits, lanes), generate


@intrinsic
def store(_context, _address, vector):  # type: ignore[no-untyped-def]
    """Writes a vector to memory, at any alignment."""

    def generate(context, builder, _signature, arguments):  # type: ignore[no-untyped-def]
        pointer = builder.inttoptr(arguments[0], llvm_type(vector).as_pointer())
        builder.store(arguments[1], pointer, align=1)
        return context.get_dummy_value()

    return types.void(types.intp, vector), generate


@intrinsic(prefer_literal=True)
def splat(_context, _value, bits, lanes):  # type: ignore[no-untyped-def]
    """The low bits of an integer in every lane."""
    vector = Vector(bits.literal_value, lanes.literal_value)

    def generate(_context, builder, _signature, arguments):  # type: ignore[no-untyped-def]
        return spread(builder, builder.trunc(arguments[0], ir.IntType(vector.bits)), vector.lanes)

    return vector(types.intp, bits, lanes), generate


@intrinsic(prefer_literal=True)
def integer_at(_context, _address, bits):  # type: ignore[no-untyped-def]
    """The unsigned integer of so many bits at an address."""
    element = ir.IntType(bits.literal_value)

    def generate(_context, builder, _signature, arguments):  # type: ignore[no-untyped-def]
        pointer = builder.inttoptr(arguments[0], element.as_pointer())
        value = builder.load(pointer, align=1, typ=element)
        return value if bits.literal_value == 64 else builder.zext(value, ir.IntType(64))

    return types.intp(types.intp, bits), generate


@intrinsic
def float_at(_context, _address):  # type: ignore[no-untyped-def]
    """The float32 at an address."""

    def generate(_context, builder, _signature, arguments):  # type: ignore[no-untyped-def]
        pointer = builder.inttoptr(arguments[0], ir.FloatType().as_pointer())
        return builder.load(pointer, align=4, typ=ir.FloatType())

    return types.float32(types.intp), generate


@intrinsic
def put_float(_context, _address, _value):  # type: ignore[no-untyped-def]
    """Writes a float32 to an address."""

    def generate(context, builder, _signature, arguments):  # type: ignore[no-untyped-def]
        builder.store(arguments[1], builder.inttoptr(arguments[0], ir.FloatType().as_pointer()), align=4)
        return context.get_dummy_value()

    return types.void(types.intp, types.float32), generate


@intrinsic
def put_word(_context, _address, _value):  # type: ignore[no-untyped-def]
    """Writes eight bytes to an address."""

    def generate(context, builder, _signature, arguments):  # type: ignore[no-untyped-def]
        builder.store(arguments[1], builder.inttoptr(arguments[0], _WORD.as_pointer()), align=1)
        return context.get_dummy_value()

    return types.void(types.intp, types.intp), generate


@intrinsic(prefer_literal=True)
def prefetch(_context, _address, level):  # type: ignore[no-untyped-def]
    """Asks for the cache line at an address, to be in the cache of a level, 1 or 2, when it is read."""
    locality = 4 - level.literal_value

    def generate(context, builder, _signature, arguments):  # type: ignore[no-untyped-def]
        pointer, flag = _BYTE.as_pointer(), ir.IntType(32)
        kind = ir.FunctionType(ir.VoidType(), [pointer, flag, flag, flag])
        function = builder.module.declare_intrinsic("llvm.prefetch", (pointer,), kind)
        address = builder.inttoptr(arguments[0], pointer)
        builder.call(function, [address, flag(0), flag(locality), flag(1)])
        return context.get_dummy_value()

    return types.void(types.intp, level), generate


@intrinsic
def greater(_context, left, right):  # type: ignore[no-untyped-def]
    """A mask of the lanes in which left exceeds right, both signed."""

    def generate(_context, builder, _signature, arguments):  # type: ignore[no-untyped-def]
        return builder.icmp_signed(">", *arguments)

    return Vector(1, left.lanes)(left, right), generate


@intrinsic
def not_above(_context, left, right):  # type: ignore[no-untyped-def]
    """A mask of the lanes in which left is at most right, both float32 and neither missing."""

    def generate(_context, builder, _signature, arguments):  # type: ignore[no-untyped-def]
        return builder.fcmp_ordered("<=", *arguments)

    return Vector(1, left.lanes)(left, right), generate


@intrinsic(prefer_literal=True)
def splat_float(_context, _value, lanes):  # type: ignore[no-untyped-def]
    """A float32 in every lane."""
    vector = FloatVector(lanes.literal_value)

    def generate(_context, builder, _signature, arguments):  # type: ignore[no-untyped-def]
        return spread(builder, arguments[0], vector.lanes)

    return vector(types.float32, lanes), generate


@intrinsic
def neither(_context, left, right):  # type: ignore[no-untyped-def]
    """A mask of the lanes that two masks leave out."""

    def generate(_context, builder, _signature, arguments):  # type: ignore[no-untyped-def]
        return builder.not_(builder.or_(*arguments))

    return left(left, right), generate


@intrinsic
def count(_context, mask):  # type: ignore[no-untyped-def]
    """How many lanes a mask has."""

    def generate(_context, builder, _signature, arguments):  # type: ignore[no-untyped-def]
        bits = ir.IntType(mask.lanes)
        number = builder.ctpop(builder.bitcast(arguments[0], bits))
        return builder.zext(number, _WORD)

    return types.intp(mask), generate


@intrinsic
def select(_context, mask, true, false):  # type: ignore[no-untyped-def]
    """One of two vectors, lane by lane."""

    def generate(_context, builder, _signature, arguments):  # type: ignore[no-untyped-def]
        return builder.select(*arguments)

    return true(mask, true, false), generate


@intrinsic
def add(_context, left, right):  # type: ignore[no-untyped-def]
    """The sums of two vectors of float32, lane by lane."""

    def generate(_context, builder, _signature, arguments):  # type: ignore[no-untyped-def]
        return builder.fadd(*arguments)

    return left(left, right), generate


@intrinsic
def plus(_context, left, right):  # type: ignore[no-untyped-def]
    """The sums of two vectors of integers, lane by lane."""

    def generate(_context, builder, _signature, arguments):  # type: ignore[no-untyped-def]
        return builder.add(*arguments)

    return left(left, right), generate


@intrinsic(prefer_literal=True)
def lowest_bits(_context, vector, bits):  # type: ignore[no-untyped-def]
    """Integers of which only so many bits are kept."""

    def generate(_context, builder, _signature, arguments):  # type: ignore[no-untyped-def]
        kept = ir.Constant(llvm_type(vector), [(1 << bits.literal_value) - 1] * vector.lanes)
        return builder.and_(arguments[0], kept)

    return vector(vector, bits), generate


@intrinsic
def plus_within(_context, left, right):  # type: ignore[no-untyped-def]
    """The sums of two vectors of signed integers; the greatest one where a sum is too large."""

    def generate(_context, builder, _signature, arguments):  # type: ignore[no-untyped-def]
        kind = llvm_type(left)
        name = f"llvm.sadd.sat.v{left.lanes}i{left.bits}"
        function = builder.module.declare_intrinsic(name, (), ir.FunctionType(kind, [kind, kind]))
        return builder.call(function, arguments)

    return left(left, right), generate


@intrinsic
def minus(_context, left, right):  # type: ignore[no-untyped-def]
    """The differences of two vectors of integers, lane by lane."""

    def generate(_context, builder, _signature, arguments):  # type: ignore[no-untyped-def]
        return builder.sub(*arguments)

    return left(left, right), generate


@intrinsic(prefer_literal=True)
def load_floats(_context, _address, lanes):  # type: ignore[no-untyped-def]
    """Reads float32 values from memory."""
    vector = FloatVector(lanes.literal_value)

    def generate(_context, builder, _signature, arguments):  # type: ignore[no-untyped-def]
        pointer = builder.inttoptr(arguments[0], llvm_type(vector).as_pointer())
        return builder.load(pointer, align=4, typ=llvm_type(vector))

    return vector(types.intp, lanes), generate


def spread(builder: ir.IRBuilder, value: ir.Value, lanes: int) -> ir.Value:
    """Generates a vector of one value in every lane."""
    one = ir.VectorType(value.type, 1)
    single = builder.insert_element(ir.Constant(one, ir.Undefined), value, ir.IntType(32)(0))
    return builder.shuffle_vector(single, single, lane_numbers([0] * lanes))


def take(builder: ir.IRBuilder, vector: ir.Value, lanes: Iterable[int]) -> ir.Value:
    """Generates a vector of some lanes of another."""
    return builder.shuffle_vector(vector, ir.Constant(vector.type, ir.Undefined), lane_numbers(lanes))


def join(builder: ir.IRBuilder, pieces: list[ir.Value]) -> ir.Value:
    """Generates one vector of the lanes of several, a power of two of them."""
    while len(pieces) > 1:
        joined = lane_numbers(range(2 * pieces[0].type.count))
        pieces = [
            builder.shuffle_vector(low, high, joined)
            for low, high in zip(pieces[::2], pieces[1::2], strict=True)
        ]
    return pieces[0]


def lane_numbers(lanes: Iterable[int]) -> ir.Constant:
    """The lanes that a shuffle of vectors takes."""
    numbers = list(lanes)
    return ir.Constant(ir.VectorType(ir.IntType(32), len(numbers)), numbers)
