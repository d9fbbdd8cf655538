"""Table look-ups in vectors: the operations that have an instruction of their own on each processor.

An instruction that the processor does not have would end the process, so each is chosen by the
features that code is generated for. Without byte shuffles (`can_look_up`), only `gather` works.
"""

from functools import reduce
from typing import Any, Final

from llvmlite import ir
from numba import types

from taxel_server.runtimes.compiled.processor import instruction_set, processor_has, register_bytes
from taxel_server.runtimes.compiled.vectors import (
    FloatVector,
    Vector,
    declare,
    join,
    lane_numbers,
    llvm_type,
    operation,
    take,
)

_BYTE: Final = ir.IntType(8)
_BYTES_IN_A_SHUFFLE: Final = 16
_BYTES_IN_A_NEON_TABLE: Final = 64


def can_look_up() -> bool:
    """Whether `lookup` can be compiled."""
    return instruction_set() != "generic"


@operation
def assemble(_context: Any, byte0: Any, byte1: Any, byte2: Any, byte3: Any) -> Any:
    """Float32 values of their four bytes, the lowest first; value i is that of lane `assembled_lane`[i]."""
    result = FloatVector(byte0.lanes)

    def generate(_context: Any, builder: Any, _signature: Any, given: Any) -> Any:
        width = min(register_bytes(), byte0.lanes)
        pieces = []
        for first in range(0, byte0.lanes, width):
            one, two, three, four = (take(builder, byte, range(first, first + width)) for byte in given)
            low, high = _unpack(builder, one, two, 1), _unpack(builder, three, four, 1)
            pieces += [part for pair in zip(low, high, strict=True) for part in _unpack(builder, *pair, 2)]
        return builder.bitcast(join(builder, pieces), llvm_type(result))

    return result(byte0, byte1, byte2, byte3), generate


def assembled_lane(lanes: int) -> list[int]:
    """The lane whose value `assemble` puts at each place: it is spared the shuffles to sort them."""
    width = min(register_bytes(), lanes)
    quarter = width // 4
    places = []
    for place in range(lanes):
        register, inside = divmod(place, width)
        part, remaining = divmod(inside, quarter)
        half, entry = divmod(remaining, 4)
        places.append(width * register + 16 * half + 4 * part + entry)
    return places


@operation
def interleave(_context: Any, _address: Any, literal_distance: Any, literal_lanes: Any) -> Any:
    """Eight rows of bytes in memory, so far apart, as vectors in which a lane's eight bytes stand together.

    The lanes come in the order of `interleaved_lane`.
    """
    vector = Vector(8, literal_lanes.literal_value)

    def generate(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        rows = [
            _load_bytes(builder, given[0], row * literal_distance.literal_value, vector.lanes)
            for row in range(8)
        ]
        pairs = [_unpack(builder, rows[row], rows[row + 1], 1) for row in range(0, 8, 2)]
        fours = [
            [
                part
                for half in (0, 1)
                for part in _unpack(builder, pairs[pair][half], pairs[pair + 1][half], 2)
            ]
            for pair in (0, 2)
        ]
        eights = [
            part
            for quarter in range(4)
            for part in _unpack(builder, fours[0][quarter], fours[1][quarter], 4)
        ]
        return context.make_tuple(builder, signature.return_type, eights)

    return types.UniTuple(vector, 8)(types.intp, literal_distance, literal_lanes), generate


def interleaved_lane(lanes: int) -> list[int]:
    """The lane at each place of what `interleave` gives for so many; sorting would take more shuffles."""
    return [
        16 * piece + 2 * part + lane for part in range(8) for piece in range(lanes // 16) for lane in (0, 1)
    ]


@operation
def gather(_context: Any, _table: Any, _places: Any, literal_upper: Any, literal_lanes: Any) -> Any:
    """The float32 values of a table at the unsigned places in memory, in the order of `assembled_lane`.

    A place is one byte. If `literal_upper` is not 0, it has an upper byte, too, so far behind the lower.
    """
    vector = FloatVector(literal_lanes.literal_value)
    distance = literal_upper.literal_value

    def generate(_context: Any, builder: Any, _signature: Any, given: Any) -> Any:
        float_type, index = ir.FloatType(), ir.IntType(64)
        base = builder.inttoptr(given[0], float_type.as_pointer())
        first = builder.inttoptr(given[1], _BYTE.as_pointer())

        def byte_at(place: int) -> ir.Value:
            byte = builder.load(builder.gep(first, [index(place)], source_etype=_BYTE), align=1, typ=_BYTE)
            return builder.zext(byte, index)

        result = ir.Constant(llvm_type(vector), ir.Undefined)
        for lane, source in enumerate(assembled_lane(vector.lanes)):
            place = byte_at(source)
            if distance:
                place = builder.or_(place, builder.shl(byte_at(source + distance), index(8)))
            leaf = builder.gep(base, [place], source_etype=float_type)
            value = builder.load(leaf, align=4, typ=float_type)
            result = builder.insert_element(result, value, ir.IntType(32)(lane))
        return result

    return vector(types.intp, types.intp, literal_upper, literal_lanes), generate


@operation
def lookup(_context: Any, _table: Any, literal_size: Any, places: Any) -> Any:
    """table[place] in every lane; the table has `literal_size` bytes: 16, 32, 48, 64, 128 or 256."""

    def generate(_context: Any, builder: Any, _signature: Any, given: Any) -> Any:
        width = min(register_bytes(), places.lanes)
        if instruction_set() == "neon":
            permute = _permute_by_neon_tables
        elif width == 64 and processor_has("avx512vbmi"):
            permute = _permute_by_wide_table
        else:
            permute = _permute_by_shuffles
        pieces = [
            permute(
                builder,
                given[0],
                literal_size.literal_value,
                take(builder, given[2], range(first, first + width)),
            )
            for first in range(0, places.lanes, width)
        ]
        return join(builder, pieces)

    return places(types.intp, literal_size, places), generate


def _permute_by_shuffles(builder: ir.IRBuilder, table: ir.Value, size: int, places: ir.Value) -> ir.Value:
    """One byte shuffle for every 16 entries; the places' upper bits choose among their results."""
    width = places.type.count
    name = {
        16: "llvm.x86.ssse3.pshuf.b.128",
        32: "llvm.x86.avx2.pshuf.b",
        64: "llvm.x86.avx512.pshuf.b.512",
    }
    function = declare(builder, name[width], places.type, [places.type, places.type])
    add_up_to = declare(builder, f"llvm.uadd.sat.v{width}i8", places.type, [places.type, places.type])
    found = []
    for first in range(0, size, _BYTES_IN_A_SHUFFLE):
        # A shuffle looks at the lowest four bits, and gives 0 where the highest is set.
        inside = places
        if first:
            inside = builder.xor(places, _constant(first, width))
        inside = builder.call(add_up_to, [inside, _constant(0x80 - _BYTES_IN_A_SHUFFLE, width)])
        # Loaded one by one, or LLVM would load them together and spend shuffles to part them.
        entries = _load_bytes(builder, table, first, _BYTES_IN_A_SHUFFLE)
        everywhere = take(builder, entries, [lane % _BYTES_IN_A_SHUFFLE for lane in range(width)])
        found.append(builder.call(function, [everywhere, inside]))
    return reduce(builder.or_, found)  # where one has found an entry, the others are 0


def _permute_by_neon_tables(
    builder: ir.IRBuilder, table: ir.Value, size: int, places: ir.Value
) -> ir.Value:
    """ARM's TBL: 16, 32, 48 or 64 entries in one instruction, which gives 0 for places beyond them."""
    found = []
    for first in range(0, size, _BYTES_IN_A_NEON_TABLE):
        entries = [
            _load_bytes(builder, table, start, 16)
            for start in range(first, min(first + _BYTES_IN_A_NEON_TABLE, size), 16)
        ]
        name = f"llvm.aarch64.neon.tbl{len(entries)}.v16i8"
        function = declare(builder, name, places.type, [places.type] * (len(entries) + 1))
        inside = builder.sub(places, _constant(first, 16)) if first else places
        found.append(builder.call(function, [*entries, inside]))
    return reduce(builder.or_, found)  # where one has found an entry, the others are 0


def _permute_by_wide_table(builder: ir.IRBuilder, table: ir.Value, size: int, places: ir.Value) -> ir.Value:
    """AVX-512 VBMI: 64 or 128 entries in one instruction."""
    vector = places.type
    if size <= 64:
        entries = _load_bytes(builder, table, 0, size)
        function = declare(builder, "llvm.x86.avx512.permvar.qi.512", vector, [vector, vector])
        return builder.call(function, [take(builder, entries, [lane % size for lane in range(64)]), places])
    function = declare(builder, "llvm.x86.avx512.vpermi2var.qi.512", vector, [vector] * 3)
    found = []
    for first in range(0, size, 128):
        low = _load_bytes(builder, table, first, 64)
        high = _load_bytes(builder, table, first + 64, 64)
        found.append(builder.call(function, [low, places, high]))
    # A table of 256 has two halves, and the places' highest bit tells which. One of 128 has only one.
    upper = builder.icmp_signed("<", places, _constant(0, 64))
    return builder.select(upper, found[-1], found[0])


def _unpack(builder: ir.IRBuilder, left: ir.Value, right: ir.Value, size: int) -> list[ir.Value]:
    """Alternates elements of `size` bytes, for the low and the high half of every 16 bytes."""
    count = left.type.count
    halves = []
    for half in (0, 8):
        places = []
        for first in range(0, count, 16):
            for element in range(first + half, first + half + 8, size):
                places += [*range(element, element + size), *range(count + element, count + element + size)]
        halves.append(builder.shuffle_vector(left, right, lane_numbers(places)))
    return halves


def _load_bytes(builder: ir.IRBuilder, address: ir.Value, first: int, count: int) -> ir.Value:
    vector = ir.VectorType(_BYTE, count)
    pointer = builder.inttoptr(builder.add(address, address.type(first)), vector.as_pointer())
    return builder.load(pointer, align=1, typ=vector)


def _constant(value: int, lanes: int) -> ir.Constant:
    return ir.Constant(ir.VectorType(_BYTE, lanes), [value] * lanes)
