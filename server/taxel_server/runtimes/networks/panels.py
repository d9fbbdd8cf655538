"""Dense layers: weights in panels of a few registers' columns, read in one stream, for a few rows at once.

Weights are float32, or integers of 24 bits that count fractions of the power of two above their column's
largest: a quarter less to read, and no further from the file than half a 2**-23 of that power, which is
what rounding to float32 costs a sum of products anyway.
"""

from typing import Final, NamedTuple

import numba
import numpy as np
from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic
from numpy.typing import NDArray

from taxel_server.runtimes.compiled.processor import register_bytes
from taxel_server.runtimes.compiled.vectors import float_at, join, lane_numbers, put_float, spread

LANES: Final = register_bytes() // 2
"""Columns of a panel: two registers, so that eight rows' sums stay in registers."""

MOST_ROWS: Final = 8
"""Rows that meet a panel at once."""

ROUNDED: Final = 24
EXACT: Final = 32
"""Bits of a weight."""

_FRACTIONS: Final = 2 ** (ROUNDED - 1)
_LOWER_BITS: Final = 16
"""Of a rounded weight's 24, stored apart from the upper ones."""

_FIRST: Final = [8 * (lane // 4) + lane % 4 for lane in range(LANES // 2)]
"""The places of two bytes whose weights stand in the first register, the next four in the second.

So alternates an instruction that every processor has: the low or high half of every 16 bytes.
"""

_STORED: Final = np.argsort([*_FIRST, *(place + 4 for place in _FIRST)])
"""The column at each place."""

_MOST_UNEVEN: Final = 64
"""Columns whose largest weight is further above their root mean square keep float32."""

_FLOAT: Final = ir.FloatType()
_VECTOR: Final = ir.VectorType(_FLOAT, LANES)
_WORD: Final = ir.IntType(64)


class Panels(NamedTuple):
    """A layer's weights.

    Attributes:
        bits: of a weight.
        content: the panels, one after the other; in each, row after row of the weights.
        scale: of each column, padded to whole panels.
    """

    bits: int
    content: NDArray[np.uint8]
    scale: NDArray[np.float32]


def arrange(weights: NDArray[np.float32], rounded: bool) -> Panels:
    """Weights (in, out) in panels, rounded if that is wanted and their columns are even enough."""
    terms, columns = weights.shape
    panels = -(-columns // LANES)
    padded = np.zeros((terms, panels * LANES), np.float32)
    padded[:, :columns] = weights
    if not rounded or _uneven(padded):
        content = np.ascontiguousarray(padded.reshape(terms, panels, LANES).transpose(1, 0, 2))
        return Panels(EXACT, content.view(np.uint8).reshape(-1), np.ones(panels * LANES, np.float32))
    _, exponent = np.frexp(np.abs(padded).max(axis=0))
    whole = np.ldexp(1.0, exponent)
    numbers = np.rint(padded.astype(np.float64) / whole * _FRACTIONS).clip(-_FRACTIONS, _FRACTIONS - 1)
    parts = numbers.astype(np.int32).reshape(terms, panels, LANES)[:, :, _STORED]
    parts = np.ascontiguousarray(parts.transpose(1, 0, 2))
    lower = (parts & 0xFFFF).astype(np.uint16).view(np.uint8)
    upper = (parts >> _LOWER_BITS).astype(np.int8).view(np.uint8)
    content = np.concatenate([lower, upper], axis=2)
    return Panels(ROUNDED, content.reshape(-1), (whole / _FRACTIONS).astype(np.float32))


def _uneven(weights: NDArray[np.float32]) -> bool:
    mean_square = np.square(weights, dtype=np.float64).mean(axis=0)
    return bool((np.abs(weights).max(axis=0) > _MOST_UNEVEN * np.sqrt(mean_square)).any())


@intrinsic
def _meet(_context, _bits, _rows, _values, _stride, _panel, _terms, _scale, _bias, _place, _apart):  # type: ignore[no-untyped-def]
    """Writes so many rows' sums of products with a panel, scaled and with a bias.

    Rows, at most `MOST_ROWS`, are a stride of bytes apart where they are read, and `apart` where written.
    """

    def generate(context, builder, _signature, arguments):  # type: ignore[no-untyped-def]
        bits, rows = arguments[:2]
        after = builder.append_basic_block("after")
        choice = builder.switch(builder.add(builder.shl(rows, _WORD(8)), bits), after)
        for width in (ROUNDED, EXACT):
            for count in range(1, MOST_ROWS + 1):
                block = builder.append_basic_block(f"panel.{width}.{count}")
                choice.add_case(_WORD((count << 8) + width), block)
                builder.position_at_end(block)
                _meet_rows(builder, width, count, *arguments[2:])
                builder.branch(after)
        builder.position_at_end(after)
        return context.get_dummy_value()

    return types.void(*[types.intp] * 10), generate


def _meet_rows(
    builder: ir.IRBuilder,
    bits: int,
    count: int,
    values: ir.Value,
    stride: ir.Value,
    panel: ir.Value,
    terms: ir.Value,
    scale: ir.Value,
    bias: ir.Value,
    place: ir.Value,
    apart: ir.Value,
) -> None:
    """Generates `_meet` for one number of rows and one kind of weights."""
    # One sum after the other would wait for itself: few rows have two of each.
    chains = 2 if count <= 2 else 1
    nothing = ir.Constant(_VECTOR, [0.0] * LANES)
    sums = [[cgutils.alloca_once_value(builder, nothing) for _ in range(count)] for _ in range(chains)]
    rows = [builder.add(values, builder.mul(stride, _WORD(row))) for row in range(count)]

    def add_term(term: ir.Value, chain: list[ir.Value]) -> None:
        weights = _weights(builder, builder.add(panel, builder.mul(term, _WORD(LANES * bits // 8))), bits)
        for row, total in zip(rows, chain, strict=True):
            address = builder.add(row, builder.mul(term, _WORD(4)))
            value = builder.load(builder.inttoptr(address, _FLOAT.as_pointer()), align=4, typ=_FLOAT)
            factor = spread(builder, value, LANES)
            builder.store(_plus_product(builder, factor, weights, _now(builder, total)), total)

    with cgutils.for_range(builder, builder.udiv(terms, _WORD(chains))) as loop:
        first = builder.mul(loop.index, _WORD(chains))
        for number, chain in enumerate(sums):
            add_term(builder.add(first, _WORD(number)), chain)
    if chains == 2:
        with builder.if_then(builder.trunc(terms, ir.IntType(1))):
            add_term(builder.sub(terms, _WORD(1)), sums[0])
    scales, biases = _load(builder, scale, _FLOAT), _load(builder, bias, _FLOAT)
    for row, parts in enumerate(zip(*sums, strict=True)):
        total = _now(builder, parts[0])
        for part in parts[1:]:
            total = builder.fadd(total, _now(builder, part))
        address = builder.add(place, builder.mul(apart, _WORD(row)))
        value = _plus_product(builder, total, scales, biases)
        builder.store(value, builder.inttoptr(address, _VECTOR.as_pointer()), align=4)


def _weights(builder: ir.IRBuilder, address: ir.Value, bits: int) -> ir.Value:
    """A panel's row of weights, without their scale."""
    if bits == EXACT:
        return _load(builder, address, _FLOAT)
    lower = _load(builder, address, ir.IntType(_LOWER_BITS))
    upper = _load(builder, builder.add(address, _WORD(2 * LANES)), ir.IntType(8))
    upper = builder.sext(upper, lower.type)
    registers = []
    for shift in (0, 4):
        places = [place + shift for place in _FIRST]
        alternating = lane_numbers(lane for place in places for lane in (place, place + LANES))
        halves = builder.shuffle_vector(lower, upper, alternating)
        numbers = builder.bitcast(halves, ir.VectorType(ir.IntType(32), LANES // 2))
        registers.append(builder.sitofp(numbers, ir.VectorType(_FLOAT, LANES // 2)))
    return join(builder, registers)


def _load(builder: ir.IRBuilder, address: ir.Value, element: ir.Type) -> ir.Value:
    kind = ir.VectorType(element, LANES)
    return builder.load(builder.inttoptr(address, kind.as_pointer()), align=1, typ=kind)


def _now(builder: ir.IRBuilder, variable: ir.Value) -> ir.Value:
    return builder.load(variable, typ=_VECTOR)


def _plus_product(builder: ir.IRBuilder, one: ir.Value, other: ir.Value, total: ir.Value) -> ir.Value:
    """Rounded once where the processor can, elsewhere twice."""
    kind = ir.FunctionType(_VECTOR, [_VECTOR] * 3)
    function = builder.module.declare_intrinsic(f"llvm.fmuladd.v{LANES}f32", (), kind)
    return builder.call(function, [one, other, total])


@numba.njit
def meet_panel(bits, values, stride, rows, terms, panel, scale, bias, result, columns, column, spare):  # type: ignore[no-untyped-def]
    """Rows of float32 on one panel: some columns, from `column` on, of a result (rows, columns).

    All but `bits` and the counts are addresses, and the stride of the rows is in bytes. `spare` has
    room for `MOST_ROWS` rows of a panel.
    """
    groups, whole = -(-rows // MOST_ROWS), column + LANES <= columns
    apart, first = (4 * columns if whole else 4 * LANES), 0
    for group in range(groups):
        after = rows * (group + 1) // groups
        place = result + 4 * (first * columns + column)
        written, source = (place if whole else spare), values + first * stride
        _meet(bits, after - first, source, stride, panel, terms, scale, bias, written, apart)
        if not whole:
            for row in range(after - first):
                for lane in range(columns - column):
                    value = float_at(spare + 4 * (row * LANES + lane))
                    put_float(place + 4 * (row * columns + lane), value)
        first = after


@numba.njit
def dense(values, rows, terms, columns, bits, panels, scale, bias, result, spare):  # type: ignore[no-untyped-def]
    """Rows (rows, terms) on a layer's panels, to (rows, columns); arguments as of `meet_panel`."""
    for column in range(0, columns, LANES):
        scales, biases = scale + 4 * column, bias + 4 * column
        meet_panel(
            bits, values, 4 * terms, rows, terms, panels, scales, biases, result, columns, column, spare
        )
        panels += terms * LANES * bits // 8
