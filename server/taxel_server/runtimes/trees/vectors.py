"""SIMD vectors as a numba type, and the few operations on them that the kernels need.

A `Vector` is an LLVM vector of integers that lives in an ordinary variable of a compiled function.
All operations but `lookup` are LLVM's own and run on any processor; lanes beyond a register's are
split by LLVM. Addresses are plain integers: nothing checks bounds. Whoever edits this file must
touch the kernels' files too, for numba's cache looks only at the file of the kernel itself.
"""

from typing import Any, Final

from llvmlite import ir
from numba.core import types
from numba.core.registry import cpu_target
from numba.extending import intrinsic, models, register_model

_BYTE: Final = ir.IntType(8)
_BYTES_IN_A_SHUFFLE: Final = 16


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


@register_model(Vector)
class _VectorModel(models.PrimitiveModel):  # type: ignore[misc]
    def __init__(self, manager: Any, vector: Vector) -> None:
        super().__init__(manager, vector, _llvm(vector))


@register_model(FloatVector)
class _FloatVectorModel(models.PrimitiveModel):  # type: ignore[misc]
    def __init__(self, manager: Any, vector: FloatVector) -> None:
        super().__init__(manager, vector, _llvm(vector))


def _llvm(vector: Vector | FloatVector) -> ir.VectorType:
    if isinstance(vector, FloatVector):
        return ir.VectorType(ir.FloatType(), vector.lanes)
    return ir.VectorType(ir.IntType(vector.bits), vector.lanes)


def processor_has(*features: str) -> bool:
    """Whether code is generated for a processor with all these features, in LLVM's names."""
    _, _, found = cpu_target.target_context.codegen().magic_tuple()
    return {f"+{feature}" for feature in features} <= set(found.split(","))


def can_look_up() -> bool:
    """Whether `lookup` can be compiled."""
    return processor_has("ssse3")


@intrinsic(prefer_literal=True)
def load(_context, _address, bits, lanes):  # type: ignore[no-untyped-def]
    """Reads a vector from memory, at any alignment."""
    vector = Vector(bits.literal_value, lanes.literal_value)

    def generate(_context, builder, _signature, arguments):  # type: ignore[no-untyped-def]
        pointer = builder.inttoptr(arguments[0], _llvm(vector).as_pointer())
        return builder.load(pointer, align=1, typ=_llvm(vector))

    return vector(types.intp, bits, lanes), generate


@intrinsic
def store(_context, _address, vector):  # type: ignore[no-untyped-def]
    """Writes a vector to memory, at any alignment."""

    def generate(context, builder, _signature, arguments):  # type: ignore[no-untyped-def]
        pointer = builder.inttoptr(arguments[0], _llvm(vector).as_pointer())
        builder.store(arguments[1], pointer, align=1)
        return context.get_dummy_value()

    return types.void(types.intp, vector), generate


@intrinsic(prefer_literal=True)
def splat(_context, _value, bits, lanes):  # type: ignore[no-untyped-def]
    """The low bits of an integer in every lane."""
    vector = Vector(bits.literal_value, lanes.literal_value)

    def generate(_context, builder, _signature, arguments):  # type: ignore[no-untyped-def]
        return _splat(builder, builder.trunc(arguments[0], ir.IntType(vector.bits)), vector.lanes)

    return vector(types.intp, bits, lanes), generate


@intrinsic(prefer_literal=True)
def splat_at(_context, _address, bits, lanes):  # type: ignore[no-untyped-def]
    """The integer at an address in every lane."""
    vector = Vector(bits.literal_value, lanes.literal_value)
    element = ir.IntType(vector.bits)

    def generate(_context, builder, _signature, arguments):  # type: ignore[no-untyped-def]
        pointer = builder.inttoptr(arguments[0], element.as_pointer())
        return _splat(builder, builder.load(pointer, align=1, typ=element), vector.lanes)

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
        pointer = builder.inttoptr(arguments[0], ir.FloatType().as_pointer())
        builder.store(arguments[1], pointer, align=4)
        return context.get_dummy_value()

    return types.void(types.intp, types.float32), generate


@intrinsic
def prefetch(_context, _address):  # type: ignore[no-untyped-def]
    """Asks for the cache line at an address, to be read soon."""

    def generate(context, builder, _signature, arguments):  # type: ignore[no-untyped-def]
        pointer, flag = _BYTE.as_pointer(), ir.IntType(32)
        kind = ir.FunctionType(ir.VoidType(), [pointer, flag, flag, flag])
        function = builder.module.declare_intrinsic("llvm.prefetch", (pointer,), kind)
        builder.call(function, [builder.inttoptr(arguments[0], pointer), flag(0), flag(3), flag(1)])
        return context.get_dummy_value()

    return types.void(types.intp), generate


@intrinsic
def greater(_context, left, right):  # type: ignore[no-untyped-def]
    """A mask of the lanes in which left exceeds right, both signed."""

    def generate(_context, builder, _signature, arguments):  # type: ignore[no-untyped-def]
        return builder.icmp_signed(">", *arguments)

    return Vector(1, left.lanes)(left, right), generate


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
def unbias(_context, vector):  # type: ignore[no-untyped-def]
    """Signed integers plus 2**(bits - 1), as unsigned ones."""

    def generate(_context, builder, _signature, arguments):  # type: ignore[no-untyped-def]
        bias = ir.Constant(_llvm(vector), [1 << (vector.bits - 1)] * vector.lanes)
        return builder.xor(arguments[0], bias)

    return vector(vector), generate


@intrinsic
def assemble(_context, byte0, byte1, byte2, byte3):  # type: ignore[no-untyped-def]
    """Float32 values of their four bytes, the lowest first; value i is that of lane `assembled_lane`[i]."""
    result = FloatVector(byte0.lanes)

    def generate(_context, builder, _signature, arguments):  # type: ignore[no-untyped-def]
        width = min(register_bytes(), byte0.lanes)
        pieces = []
        for first in range(0, byte0.lanes, width):
            one, two, three, four = (
                _take(builder, byte, range(first, first + width)) for byte in arguments
            )
            low, high = _unpack(builder, one, two, 1), _unpack(builder, three, four, 1)
            pieces += [part for pair in zip(low, high, strict=True) for part in _unpack(builder, *pair, 2)]
        return builder.bitcast(_join(builder, pieces), _llvm(result))

    return result(byte0, byte1, byte2, byte3), generate


def assembled_lane(lanes: int) -> list[int]:
    """The lane whose value `assemble` puts at each place: it is spared the shuffles to sort them."""
    width = min(register_bytes(), lanes)
    quarter = width // 4
    places = []
    for place in range(lanes):
        register, inside = divmod(place, width)
        part, rest = divmod(inside, quarter)
        half, entry = divmod(rest, 4)
        places.append(width * register + 16 * half + 4 * part + entry)
    return places


@intrinsic(prefer_literal=True)
def load_floats(_context, _address, lanes):  # type: ignore[no-untyped-def]
    """Reads float32 values from memory."""
    vector = FloatVector(lanes.literal_value)

    def generate(_context, builder, _signature, arguments):  # type: ignore[no-untyped-def]
        pointer = builder.inttoptr(arguments[0], _llvm(vector).as_pointer())
        return builder.load(pointer, align=4, typ=_llvm(vector))

    return vector(types.intp, lanes), generate


@intrinsic(prefer_literal=True)
def splat_float(_context, _value, lanes):  # type: ignore[no-untyped-def]
    """A float32 in every lane."""
    vector = FloatVector(lanes.literal_value)

    def generate(_context, builder, _signature, arguments):  # type: ignore[no-untyped-def]
        return _splat(builder, arguments[0], vector.lanes)

    return vector(types.float32, lanes), generate


@intrinsic(prefer_literal=True)
def gather(_context, _table, _places, bits, lanes):  # type: ignore[no-untyped-def]
    """The float32 values of a table at the unsigned places in memory, in the order of `assembled_lane`."""
    vector = FloatVector(lanes.literal_value)
    integer = ir.IntType(bits.literal_value)

    def generate(_context, builder, _signature, arguments):  # type: ignore[no-untyped-def]
        float_type, index = ir.FloatType(), ir.IntType(64)
        base = builder.inttoptr(arguments[0], float_type.as_pointer())
        first = builder.inttoptr(arguments[1], integer.as_pointer())
        result = ir.Constant(_llvm(vector), ir.Undefined)
        for lane, source in enumerate(assembled_lane(vector.lanes)):
            place = builder.load(
                builder.gep(first, [index(source)], source_etype=integer), align=1, typ=integer
            )
            leaf = builder.gep(base, [builder.zext(place, index)], source_etype=float_type)
            value = builder.load(leaf, align=4, typ=float_type)
            result = builder.insert_element(result, value, ir.IntType(32)(lane))
        return result

    return vector(types.intp, types.intp, bits, lanes), generate


@intrinsic(prefer_literal=True)
def lookup(_context, _table, size, places):  # type: ignore[no-untyped-def]
    """table[place] in every lane: `size` bytes in memory, 16, 32, 48, 64, 128 or 256 of them."""

    def generate(_context, builder, _signature, arguments):  # type: ignore[no-untyped-def]
        width = min(register_bytes(), places.lanes)
        wide = width == 64 and processor_has("avx512vbmi")
        permute = _permute_by_wide_table if wide else _permute_by_shuffles
        pieces = [
            permute(
                builder,
                arguments[0],
                size.literal_value,
                _take(builder, arguments[2], range(first, first + width)),
            )
            for first in range(0, places.lanes, width)
        ]
        return _join(builder, pieces)

    return places(types.intp, size, places), generate


def _permute_by_shuffles(builder: ir.IRBuilder, table: ir.Value, size: int, places: ir.Value) -> ir.Value:
    """One byte shuffle for every 16 entries; the places' upper bits choose among their results."""
    width = places.type.count
    name = {
        16: "llvm.x86.ssse3.pshuf.b.128",
        32: "llvm.x86.avx2.pshuf.b",
        64: "llvm.x86.avx512.pshuf.b.512",
    }
    function = _declare(builder, name[width], places.type, [places.type, places.type])
    # A shuffle looks at the lowest four bits, and gives 0 where the highest is set.
    low = builder.and_(places, _constant(0x0F, width)) if size > 128 else places
    found = []
    for first in range(0, size, _BYTES_IN_A_SHUFFLE):
        # Loaded one by one, or LLVM would load them together and spend shuffles to part them.
        entries = _load_bytes(builder, table, first, _BYTES_IN_A_SHUFFLE)
        everywhere = _take(builder, entries, [lane % _BYTES_IN_A_SHUFFLE for lane in range(width)])
        found.append(builder.call(function, [everywhere, low]))
    return _choose(builder, found, places, bit=4)


def _permute_by_wide_table(builder: ir.IRBuilder, table: ir.Value, size: int, places: ir.Value) -> ir.Value:
    """AVX-512 VBMI: 64 or 128 entries in one instruction."""
    vector = places.type
    if size <= 64:
        entries = _load_bytes(builder, table, 0, size)
        function = _declare(builder, "llvm.x86.avx512.permvar.qi.512", vector, [vector, vector])
        return builder.call(
            function, [_take(builder, entries, [lane % size for lane in range(64)]), places]
        )
    function = _declare(builder, "llvm.x86.avx512.vpermi2var.qi.512", vector, [vector] * 3)
    found = []
    for first in range(0, size, 128):
        low = _load_bytes(builder, table, first, 64)
        high = _load_bytes(builder, table, first + 64, 64)
        found.append(builder.call(function, [low, places, high]))
    return _choose(builder, found, places, bit=7)


def _choose(builder: ir.IRBuilder, found: list[ir.Value], places: ir.Value, bit: int) -> ir.Value:
    """Halves the candidates by one bit of the places after another, the lowest first."""
    while len(found) > 1:
        shifted = builder.shl(places, _constant(7 - bit, places.type.count))
        upper = builder.icmp_signed("<", shifted, _constant(0, places.type.count))
        last = found[len(found) // 2 * 2 :]
        found = [
            builder.select(upper, high, low) for low, high in zip(found[::2], found[1::2], strict=False)
        ]
        found += last
        bit += 1
    return found[0]


def _unpack(builder: ir.IRBuilder, left: ir.Value, right: ir.Value, size: int) -> list[ir.Value]:
    """Alternates elements of `size` bytes, for the low and the high half of every 16 bytes."""
    count = left.type.count
    halves = []
    for half in (0, 8):
        places = []
        for first in range(0, count, 16):
            for element in range(first + half, first + half + 8, size):
                places += [*range(element, element + size), *range(count + element, count + element + size)]
        halves.append(builder.shuffle_vector(left, right, _places(places)))
    return halves


def _join(builder: ir.IRBuilder, pieces: list[ir.Value]) -> ir.Value:
    while len(pieces) > 1:
        joined = _places(range(2 * pieces[0].type.count))
        pieces = [
            builder.shuffle_vector(low, high, joined)
            for low, high in zip(pieces[::2], pieces[1::2], strict=True)
        ]
    return pieces[0]


def register_bytes() -> int:
    """Bytes in the widest register whose bytes can be shuffled."""
    return 64 if processor_has("avx512bw") else 32 if processor_has("avx2") else 16


def _declare(builder: ir.IRBuilder, name: str, result: ir.Type, arguments: list[ir.Type]) -> ir.Function:
    return builder.module.declare_intrinsic(name, (), ir.FunctionType(result, arguments))


def _load_bytes(builder: ir.IRBuilder, address: ir.Value, first: int, count: int) -> ir.Value:
    vector = ir.VectorType(_BYTE, count)
    pointer = builder.inttoptr(builder.add(address, address.type(first)), vector.as_pointer())
    return builder.load(pointer, align=1, typ=vector)


def _splat(builder: ir.IRBuilder, value: ir.Value, lanes: int) -> ir.Value:
    one = ir.VectorType(value.type, 1)
    single = builder.insert_element(ir.Constant(one, ir.Undefined), value, ir.IntType(32)(0))
    return builder.shuffle_vector(single, single, _places([0] * lanes))


def _take(builder: ir.IRBuilder, vector: ir.Value, lanes: Any) -> ir.Value:
    return builder.shuffle_vector(vector, ir.Constant(vector.type, ir.Undefined), _places(lanes))


def _places(lanes: Any) -> ir.Constant:
    numbers = list(lanes)
    return ir.Constant(ir.VectorType(ir.IntType(32), len(numbers)), numbers)


def _constant(value: int, lanes: int) -> ir.Constant:
    return ir.Constant(ir.VectorType(_BYTE, lanes), [value] * lanes)
