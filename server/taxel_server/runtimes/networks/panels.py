"""Lays out a dense layer's weights as panels, and multiplies a few rows by one panel.

A panel holds a few columns and is read in one stream. For one row, reading the weights takes the time.
So they become 24-bit integers, in units of 2**-23 of the power of two above their column's largest
weight. This is a quarter less to read than float32, and the error is at most 2**-24 of that power: each
addition of float32 rounds off as much. For more rows, the products take the time, and the weights stay
float32.

The sums of a product stay in registers; it runs on any processor.
"""

from typing import Any, Final

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numpy.typing import NDArray

from taxel_server.runtimes.compiled.processor import register_bytes
from taxel_server.runtimes.compiled.vectors import (
    broadcast,
    declare,
    join,
    lane_numbers,
    load_from,
    operation,
)

LANES: Final = register_bytes() // 2
"""Columns of a panel: two registers of float32."""

MOST_ROWS: Final = 6
"""Rows that a panel is multiplied with at once: their sums take 12 of a usual processor's 16 registers."""

FIXED_POINT: Final = 0
"""This stands for one row and weights of 24 bits, in place of the number of rows."""

_CHAINS: Final = 4
"""Partial sums that are computed side by side: each addition waits for the one before it."""

_FIRST: Final = [8 * (lane // 4) + lane % 4 for lane in range(LANES // 2)]
_HALVES: Final = (_FIRST, [lane + 4 for lane in _FIRST])
"""The places in a row of 24-bit weights that each half of the columns takes.

The lower 16 bits of a row stand before the upper 8. Every processor has an instruction that interleaves the
same half of each 16 bytes of both.
"""

_STORED: Final = np.argsort([lane for half in _HALVES for lane in half])
"""The column at each place of a row of 24-bit integers."""

_FRACTIONS: Final = 2**23

_FLOAT: Final = ir.FloatType()
_VECTOR: Final = ir.VectorType(_FLOAT, LANES)
_WORD: Final = ir.IntType(64)


def panels_of(weights: NDArray[Any], bias: NDArray[Any], exact: bool) -> NDArray[np.uint8]:
    """The panels of weights (terms, columns); the panel of the last columns comes first.

    Each panel holds `terms` rows of `LANES` weights, then the columns' scales and biases, both float32.

    Args:
        exact: whether the weights are float32, not 24-bit integers.
    """
    terms, columns = weights.shape
    count = -(-columns // LANES)
    padded = np.zeros((terms + 1, count * LANES))
    padded[:terms, :columns], padded[terms, :columns] = weights, bias
    by_panel = padded.reshape(terms + 1, count, LANES).transpose(1, 0, 2)[::-1]
    rows, biases = by_panel[:, :terms], by_panel[:, terms:]
    scales = np.ones_like(biases)
    if exact:
        content = rows.astype(np.float32, order="C").view(np.uint8)
    else:
        _, exponents = np.frexp(np.abs(rows).max(axis=1, keepdims=True))
        scales = np.ldexp(1.0 / _FRACTIONS, exponents)
        integers = np.rint((rows / scales)[:, :, _STORED]).clip(-_FRACTIONS, _FRACTIONS - 1)
        stored = integers.astype(np.int32, order="C")
        lower, upper = (stored & 0xFFFF).astype(np.uint16), (stored >> 16).astype(np.int8)
        content = np.concatenate([lower.view(np.uint8), upper.view(np.uint8)], axis=2)
    ends = np.concatenate([scales, biases], axis=1).astype(np.float32).view(np.uint8)
    return np.hstack([content.reshape(count, -1), ends.reshape(count, -1)]).reshape(-1)


@operation
def multiply_panel(
    _context: Any, _rows: Any, _values: Any, _step: Any, _panel: Any, _terms: Any, _result: Any, _apart: Any
) -> Any:
    """result = (values · panel) · scale + bias, for `LANES` columns.

    Compiled code passes integers:
        the number of rows, for a panel of float32, or `FIXED_POINT`
        the address of the values, and the bytes from row to row
        the address of the panel, and the number of its terms
        the address of the result, and the bytes from row to row
    """

    def generate(context: Any, builder: ir.IRBuilder, _: Any, arguments: list[ir.Value]) -> ir.Value:
        after = builder.append_basic_block("after")
        choice = builder.switch(arguments[0], after)
        for case in range(MOST_ROWS + 1):
            block = builder.append_basic_block(f"panel.{case}")
            choice.add_case(_WORD(case), block)
            builder.position_at_end(block)
            _generate(builder, max(case, 1), 24 if case == FIXED_POINT else 32, arguments[1:])
            builder.branch(after)
        builder.position_at_end(after)
        return context.get_dummy_value()

    return types.void(*[types.intp] * 7), generate


def _generate(builder: ir.IRBuilder, count: int, bits: int, arguments: list[ir.Value]) -> None:
    """Generates the product for one number of rows and one kind of weights."""
    values, stride, panel, terms, result, apart = arguments
    # A fused multiply-add rounds once; a processor without it rounds twice.
    multiply_add = declare(builder, f"llvm.fmuladd.v{LANES}f32", _VECTOR, [_VECTOR] * 3)
    zeros = ir.Constant(_VECTOR, [0.0] * LANES)
    chains = [
        [cgutils.alloca_once_value(builder, zeros) for _ in range(count)]
        for _ in range(max(1, _CHAINS // count))
    ]
    rows = [builder.add(values, builder.mul(stride, _WORD(row))) for row in range(count)]

    def weights_of(term: ir.Value) -> ir.Value:
        return builder.add(panel, builder.mul(term, _WORD(LANES * bits // 8)))

    def add_term(term: ir.Value, sums: list[ir.Value]) -> None:
        weights = _weights(builder, weights_of(term), bits)
        for row, total in zip(rows, sums, strict=True):
            address = builder.add(row, builder.mul(term, _WORD(4)))
            value = load_from(builder, address, _FLOAT, align=4)
            factors = [broadcast(builder, value, LANES), weights, builder.load(total, typ=_VECTOR)]
            builder.store(builder.call(multiply_add, factors), total)

    turns = builder.udiv(terms, _WORD(len(chains)))
    done = builder.mul(turns, _WORD(len(chains)))
    with cgutils.for_range(builder, turns) as loop:
        first = builder.mul(loop.index, _WORD(len(chains)))
        for number, sums in enumerate(chains):
            add_term(builder.add(first, _WORD(number)), sums)
    with cgutils.for_range(builder, builder.sub(terms, done)) as loop:
        add_term(builder.add(done, loop.index), chains[0])
    scales = load_from(builder, weights_of(terms), _VECTOR, align=1)
    biases = load_from(builder, builder.add(weights_of(terms), _WORD(4 * LANES)), _VECTOR, align=1)
    for row, parts in enumerate(zip(*chains, strict=True)):
        total = builder.load(parts[0], typ=_VECTOR)
        for part in parts[1:]:
            total = builder.fadd(total, builder.load(part, typ=_VECTOR))
        address = builder.add(result, builder.mul(apart, _WORD(row)))
        total = builder.call(multiply_add, [total, scales, biases])
        builder.store(total, builder.inttoptr(address, _VECTOR.as_pointer()), align=4)


def _weights(builder: ir.IRBuilder, address: ir.Value, bits: int) -> ir.Value:
    """Generates code that reads a panel's row, without its scale."""
    if bits == 32:
        return load_from(builder, address, _VECTOR, align=1)
    lower = load_from(builder, address, ir.VectorType(ir.IntType(16), LANES), align=1)
    after = builder.add(address, _WORD(2 * LANES))
    upper = load_from(builder, after, ir.VectorType(ir.IntType(8), LANES), align=1)
    upper = builder.sext(upper, lower.type)
    halves = []
    for places in _HALVES:
        pairs = lane_numbers(lane for place in places for lane in (place, place + LANES))
        shuffled = builder.shuffle_vector(lower, upper, pairs)
        integers = builder.bitcast(shuffled, ir.VectorType(ir.IntType(32), LANES // 2))
        halves.append(builder.sitofp(integers, ir.VectorType(_FLOAT, LANES // 2)))
    return join(builder, halves)
