"""SIMD vectors as a numba type, and the operations on them that the kernels need.

A `Vector` is an LLVM vector of integers in an ordinary variable of a compiled function. All operations run
on any processor: LLVM splits a vector that is wider than a register. Addresses are plain integers: nothing
checks bounds.
"""

from collections.abc import Callable, Iterable
from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic, models, register_model

_BYTE = ir.IntType(8)
_FLOAT = ir.FloatType()
_INT64 = ir.IntType(64)


class Vector(types.Type):  # type: ignore[misc]
    """Integers of `bits` bits in `lanes` lanes; a mask has one bit a lane."""

    def __init__(self, bits: int, lanes: int) -> None:
        self.bits = bits
        self.lanes = lanes
        super().__init__(name=f"Vector(int{bits} x {lanes})")


class FloatVector(types.Type):  # type: ignore[misc]
    """Float32 values in `lanes` lanes."""

    def __init__(self, lanes: int) -> None:
        self.lanes = lanes
        super().__init__(name=f"Vector(float32 x {lanes})")


class _VectorModel(models.PrimitiveModel):  # type: ignore[misc]
    def __init__(self, manager: Any, vector: Vector | FloatVector) -> None:
        super().__init__(manager, vector, llvm_type(vector))


register_model(Vector)(_VectorModel)
register_model(FloatVector)(_VectorModel)


def llvm_type(vector: Vector | FloatVector) -> ir.VectorType:
    """LLVM's type of a vector."""
    element = _FLOAT if isinstance(vector, FloatVector) else ir.IntType(vector.bits)
    return ir.VectorType(element, vector.lanes)


def operation(define: Callable[..., Any]) -> Any:
    """Makes an operation that compiled code calls from a function of numba's types.

    `define` takes numba's context and the types of the arguments. It gives the operation's signature and a
    function that generates its code from the context, LLVM's builder, the signature and the arguments. An
    argument with a name `literal_…` must be a constant of the compiled code.
    """
    return intrinsic(prefer_literal=True)(define)


def binary(generate: Callable[[ir.IRBuilder, ir.Value, ir.Value], ir.Value], mask: bool = False) -> Any:
    """Makes an operation on two vectors of one type. It gives a third vector of this type, or a mask."""

    @intrinsic  # type: ignore[untyped-decorator, unused-ignore]
    def combine(_context: Any, left: Any, right: Any) -> Any:
        result = Vector(1, left.lanes) if mask else left
        return result(left, right), lambda _context, builder, _signature, given: generate(builder, *given)

    return combine


greater = binary(lambda builder, left, right: builder.icmp_signed(">", left, right), mask=True)
"""A mask of the lanes in which left exceeds right, both signed."""

not_above = binary(lambda builder, left, right: builder.fcmp_ordered("<=", left, right), mask=True)
"""A mask of the lanes in which left is at most right, both float32 and neither missing."""

neither = binary(lambda builder, left, right: builder.not_(builder.or_(left, right)))
"""A mask of the lanes that are in none of two masks."""

both = binary(lambda builder, left, right: builder.and_(left, right))
either = binary(lambda builder, left, right: builder.or_(left, right))
exclusive = binary(lambda builder, left, right: builder.xor(left, right))
plus = binary(lambda builder, left, right: builder.add(left, right))
minus = binary(lambda builder, left, right: builder.sub(left, right))

add = binary(lambda builder, left, right: builder.fadd(left, right))
"""The sums of two vectors of float32."""


def _saturated_sum(builder: ir.IRBuilder, left: ir.Value, right: ir.Value) -> ir.Value:
    kind = left.type
    name = f"llvm.sadd.sat.v{kind.count}i{kind.element.width}"
    return builder.call(declare(builder, name, kind, [kind, kind]), [left, right])


plus_saturated = binary(_saturated_sum)
"""The sums of two vectors of signed integers; the greatest integer where a sum is too large."""


@operation
def load(_context: Any, _address: Any, literal_bits: Any, literal_lanes: Any) -> Any:
    """Reads a vector from memory, at any alignment."""
    vector = Vector(literal_bits.literal_value, literal_lanes.literal_value)

    def generate(_context: Any, builder: Any, _signature: Any, given: Any) -> Any:
        return load_from(builder, given[0], llvm_type(vector), 1)

    return vector(types.intp, literal_bits, literal_lanes), generate


@operation
def load_floats(_context: Any, _address: Any, literal_lanes: Any) -> Any:
    """Reads float32 values from memory."""
    vector = FloatVector(literal_lanes.literal_value)

    def generate(_context: Any, builder: Any, _signature: Any, given: Any) -> Any:
        return load_from(builder, given[0], llvm_type(vector), 4)

    return vector(types.intp, literal_lanes), generate


@operation
def integer_at(_context: Any, _address: Any, literal_bits: Any) -> Any:
    """The unsigned integer of `literal_bits` bits at an address."""
    bits = literal_bits.literal_value

    def generate(_context: Any, builder: Any, _signature: Any, given: Any) -> Any:
        value = load_from(builder, given[0], ir.IntType(bits), 1)
        return value if bits == _INT64.width else builder.zext(value, _INT64)

    return types.intp(types.intp, literal_bits), generate


@intrinsic  # type: ignore[untyped-decorator, unused-ignore]
def store(_context: Any, _address: Any, value: Any) -> Any:
    """Writes a vector, or an integer as eight bytes, to an address, at any alignment."""
    kind = types.intp if isinstance(value, types.Integer) else value

    def generate(context: Any, builder: Any, _signature: Any, given: Any) -> Any:
        builder.store(given[1], builder.inttoptr(given[0], given[1].type.as_pointer()), align=1)
        return context.get_dummy_value()

    return types.void(types.intp, kind), generate


@operation
def prefetch(_context: Any, _address: Any, literal_level: Any) -> Any:
    """Prefetches the cache line at an address into the cache of a level, 1 or 2."""
    locality = 4 - literal_level.literal_value

    def generate(context: Any, builder: Any, _signature: Any, given: Any) -> Any:
        pointer, flag = _BYTE.as_pointer(), ir.IntType(32)
        kind = ir.FunctionType(ir.VoidType(), [pointer, flag, flag, flag])
        function = builder.module.declare_intrinsic("llvm.prefetch", (pointer,), kind)
        builder.call(function, [builder.inttoptr(given[0], pointer), flag(0), flag(locality), flag(1)])
        return context.get_dummy_value()

    return types.void(types.intp, literal_level), generate


@operation
def call(_context: Any, _function: Any, arguments: Any) -> Any:
    """Calls a function by its address with the addresses and counts in a tuple; it returns nothing.

    So a kernel takes another kernel as an argument.
    """

    def generate(context: Any, builder: Any, _signature: Any, given: Any) -> Any:
        kind = ir.FunctionType(ir.VoidType(), [ir.IntType(64)] * len(arguments))
        values = [builder.extract_value(given[1], place) for place in range(len(arguments))]
        builder.call(builder.inttoptr(given[0], kind.as_pointer()), values)
        return context.get_dummy_value()

    return types.void(types.intp, arguments), generate


@operation
def splat(_context: Any, _value: Any, literal_bits: Any, literal_lanes: Any) -> Any:
    """The low bits of an integer in every lane."""
    vector = Vector(literal_bits.literal_value, literal_lanes.literal_value)

    def generate(_context: Any, builder: Any, _signature: Any, given: Any) -> Any:
        return broadcast(builder, builder.trunc(given[0], ir.IntType(vector.bits)), vector.lanes)

    return vector(types.intp, literal_bits, literal_lanes), generate


@operation
def splat_float(_context: Any, _value: Any, literal_lanes: Any) -> Any:
    """A float32 in every lane."""
    vector = FloatVector(literal_lanes.literal_value)

    def generate(_context: Any, builder: Any, _signature: Any, given: Any) -> Any:
        return broadcast(builder, given[0], vector.lanes)

    return vector(types.float32, literal_lanes), generate


@operation
def count(_context: Any, mask: Any) -> Any:
    """How many lanes a mask has."""

    def generate(_context: Any, builder: Any, _signature: Any, given: Any) -> Any:
        bits = builder.bitcast(given[0], ir.IntType(mask.lanes))
        return builder.zext(builder.ctpop(bits), _INT64)

    return types.intp(mask), generate


@operation
def select(_context: Any, mask: Any, true: Any, false: Any) -> Any:
    """One of two vectors, lane by lane."""
    return true(mask, true, false), lambda _context, builder, _signature, given: builder.select(*given)


@operation
def lowest_bits(_context: Any, vector: Any, literal_bits: Any) -> Any:
    """Integers of which only the low bits are kept."""

    def generate(_context: Any, builder: Any, _signature: Any, given: Any) -> Any:
        kept = (1 << literal_bits.literal_value) - 1
        return builder.and_(given[0], ir.Constant(llvm_type(vector), [kept] * vector.lanes))

    return vector(vector, literal_bits), generate


def load_from(builder: ir.IRBuilder, address: ir.Value, kind: ir.Type, align: int) -> ir.Value:
    """Generates the load of a value at an integer address."""
    return builder.load(builder.inttoptr(address, kind.as_pointer()), align=align, typ=kind)


def declare(builder: ir.IRBuilder, name: str, result: ir.Type, given: list[ir.Type]) -> ir.Function:
    """Declares one of LLVM's own functions by its full name."""
    return builder.module.declare_intrinsic(name, (), ir.FunctionType(result, given))


def broadcast(builder: ir.IRBuilder, value: ir.Value, lanes: int) -> ir.Value:
    """Generates a vector of one value in every lane."""
    one = ir.VectorType(value.type, 1)
    single = builder.insert_element(ir.Constant(one, ir.Undefined), value, ir.IntType(32)(0))
    return builder.shuffle_vector(single, single, lane_numbers([0] * lanes))


def take(builder: ir.IRBuilder, vector: ir.Value, lanes: Iterable[int]) -> ir.Value:
    """Generates a vector from some lanes of another vector."""
    return builder.shuffle_vector(vector, ir.Constant(vector.type, ir.Undefined), lane_numbers(lanes))


def join(builder: ir.IRBuilder, pieces: list[ir.Value]) -> ir.Value:
    """Generates one vector from the lanes of several vectors; their number is a power of two."""
    while len(pieces) > 1:
        joined = lane_numbers(range(2 * pieces[0].type.count))
        pieces = [
            builder.shuffle_vector(low, high, joined)
            for low, high in zip(pieces[::2], pieces[1::2], strict=True)
        ]
    return pieces[0]


def lane_numbers(lanes: Iterable[int]) -> ir.Constant:
    """The lane numbers of a shuffle, as LLVM's constant."""
    numbers = list(lanes)
    return ir.Constant(ir.VectorType(ir.IntType(32), len(numbers)), numbers)
