"""Carries out a program's steps, one window after the other: compiled, without the GIL."""

from typing import Any, Final

import numba
import numpy as np
from numba.np.unsafe.ndarray import to_fixed_tuple

from taxel_server.runtimes.compiled.arguments import array_at
from taxel_server.runtimes.compiled.compiling import compiled
from taxel_server.runtimes.networks.functions import (
    exponential,
    exponential_linear,
    gaussian_linear,
    hyperbolic_tangent,
    logistic,
)
from taxel_server.runtimes.networks.operations import (
    KINDS,
    WORDS,
    Arithmetic,
    Copy,
    Dense,
    Elementwise,
    Function,
    Normalise,
    Pairwise,
    Product,
    Softmax,
    Sum,
)
from taxel_server.runtimes.networks.panels import EXACT, LANES, dense, meet_panel

_SUMS: Final = {"reassoc", "contract"}
"""Sums in any order, so that registers of values are added at once."""

_ADD, _SUBTRACT, _MULTIPLY, _DIVIDE = (int(each) for each in Arithmetic)
_RELU, _LEAKY_RELU, _CLIP, _TANH, _SIGMOID, _ELU, _GELU = (int(each) for each in Function)
_DENSE, _PRODUCT, _PAIRWISE, _ELEMENTWISE, _NORMALISE, _SOFTMAX, _COPY, _SUM = range(len(KINDS))
_NOTHING: Final = np.float32(0)
_ONE: Final = np.float32(1)


def _reader(kind: type[Any]) -> Any:
    """Compiled: the record of an operation in a step."""
    count = len(kind._fields)

    @numba.njit
    def read(step):  # type: ignore[no-untyped-def]
        return kind(*to_fixed_tuple(step[1:], count))

    return read


_dense_in, _product_in, _pairwise_in, _elementwise_in = map(
    _reader, (Dense, Product, Pairwise, Elementwise)
)
_normalise_in, _softmax_in, _copy_in, _sum_in = map(_reader, (Normalise, Softmax, Copy, Sum))


@numba.njit(error_model="numpy")
def _combine(which, result, left, right):  # type: ignore[no-untyped-def]
    if which == _ADD:
        for place in range(result.size):
            result[place] = left[place] + right[place]
    elif which == _SUBTRACT:
        for place in range(result.size):
            result[place] = left[place] - right[place]
    elif which == _MULTIPLY:
        for place in range(result.size):
            result[place] = left[place] * right[place]
    else:
        for place in range(result.size):
            result[place] = left[place] / right[place]


@numba.njit
def _pairwise(step, memory):  # type: ignore[no-untyped-def]
    others = memory[step.others : step.others + step.width]
    for first in range(0, step.rows * step.width, step.width):
        result = memory[step.result + first : step.result + first + step.width]
        values = memory[step.values + first : step.values + first + step.width]
        _combine(step.which, result, values, others)


@numba.njit
def _bend(which, result, values, one, other):  # type: ignore[no-untyped-def]
    """The functions of straight pieces."""
    if which == _RELU:
        for place in range(result.size):
            result[place] = max(values[place], _NOTHING)
    elif which == _LEAKY_RELU:
        for place in range(result.size):
            result[place] = values[place] if values[place] > 0 else one * values[place]
    else:
        for place in range(result.size):
            result[place] = min(max(values[place], one), other)


@numba.njit
def _curve(which, result, values, scale):  # type: ignore[no-untyped-def]
    """The functions of powers of e."""
    if which == _TANH:
        for place in range(result.size):
            result[place] = hyperbolic_tangent(values[place])
    elif which == _SIGMOID:
        for place in range(result.size):
            result[place] = logistic(values[place])
    elif which == _ELU:
        for place in range(result.size):
            result[place] = exponential_linear(values[place], scale)
    else:
        for place in range(result.size):
            result[place] = gaussian_linear(values[place])


@numba.njit
def _elementwise(step, memory):  # type: ignore[no-untyped-def]
    result = memory[step.result : step.result + step.size]
    values = memory[step.values : step.values + step.size]
    one, other = memory[step.parameters], memory[step.parameters + 1]
    if step.which <= _CLIP:
        _bend(step.which, result, values, one, other)
    else:
        _curve(step.which, result, values, one)


@numba.njit(fastmath=_SUMS, error_model="numpy")
def _normalise_row(result, values, weight, bias, epsilon):  # type: ignore[no-untyped-def]
    total = _NOTHING
    for place in range(values.size):
        total += values[place]
    mean = total / np.float32(values.size)
    total = _NOTHING
    for place in range(values.size):
        total += (values[place] - mean) * (values[place] - mean)
    factor = _ONE / np.sqrt(total / np.float32(values.size) + epsilon)
    for place in range(values.size):
        result[place] = (values[place] - mean) * factor * weight[place] + bias[place]


@numba.njit
def _normalise(step, memory):  # type: ignore[no-untyped-def]
    weight = memory[step.weight : step.weight + step.width]
    bias = memory[step.bias : step.bias + step.width]
    for first in range(0, step.rows * step.width, step.width):
        result = memory[step.result + first : step.result + first + step.width]
        values = memory[step.values + first : step.values + first + step.width]
        _normalise_row(result, values, weight, bias, memory[step.epsilon])


@numba.njit(fastmath=_SUMS, error_model="numpy")
def _softmax(step, memory):  # type: ignore[no-untyped-def]
    """The exponentials of all rows in one go, for rows are short."""
    size, width = step.rows * step.width, step.width
    result, values = memory[step.result : step.result + size], memory[step.values : step.values + size]
    for first in range(0, size, width):
        greatest = values[first]
        for place in range(first, first + width):
            greatest = max(greatest, values[place])
        for place in range(first, first + width):
            result[place] = values[place] - greatest
    for place in range(size):
        result[place] = exponential(result[place])
    for first in range(0, size, width):
        total = _NOTHING
        for place in range(first, first + width):
            total += result[place]
        share = _ONE / total
        for place in range(first, first + width):
            result[place] *= share


@numba.njit
def _product(step, memory):  # type: ignore[no-untyped-def]
    start, stride, columns = memory.ctypes.data, 4 * step.left_row, step.columns
    panel, ones = start + 4 * step.panel, start + 4 * step.common
    nothing, spare = ones + 4 * LANES, ones + 8 * LANES
    for group in range(step.groups):
        values = start + 4 * (step.left + group * step.left_apart)
        result = start + 4 * (step.result + group * step.rows * columns)
        for column in range(0, columns, LANES):
            first = step.right + group * step.right_apart + column * step.right_column
            for term in range(step.terms):
                source, place = first + term * step.right_term, step.panel + term * LANES
                for lane in range(min(LANES, columns - column)):
                    memory[place + lane] = memory[source + lane * step.right_column]
            meet_panel(
                *(EXACT, values, stride, step.rows, step.terms, panel, ones, nothing),
                *(result, columns, column, spare),
            )


@numba.njit
def _copy(step, memory):  # type: ignore[no-untyped-def]
    place = step.result
    for one in range(step.size_1):
        for two in range(step.size_2):
            for three in range(step.size_3):
                start = step.values + one * step.stride_1 + two * step.stride_2 + three * step.stride_3
                for four in range(step.size_4):
                    memory[place] = memory[start + four * step.stride_4]
                    place += 1


@numba.njit
def _sum(step, memory):  # type: ignore[no-untyped-def]
    for one in range(step.outer):
        place = step.result + one * step.inner
        sums = memory[place : place + step.inner]
        sums[:] = _NOTHING
        for two in range(step.middle):
            start = step.values + (one * step.middle + two) * step.inner
            values = memory[start : start + step.inner]
            for three in range(step.inner):
                sums[three] += values[three]


@numba.njit
def _dense(step, memory, weights):  # type: ignore[no-untyped-def]
    start = memory.ctypes.data
    dense(
        *(start + 4 * step.values, step.rows, step.terms, step.columns, step.bits, weights + step.weights),
        *(start + 4 * step.scale, start + 4 * step.bias, start + 4 * step.result, start + 4 * step.spare),
    )


@numba.njit
def _carry_out(step, memory, weights):  # type: ignore[no-untyped-def]
    operation = step[0]
    if operation == _DENSE:
        _dense(_dense_in(step), memory, weights)
    elif operation == _PRODUCT:
        _product(_product_in(step), memory)
    elif operation == _PAIRWISE:
        _pairwise(_pairwise_in(step), memory)
    elif operation == _ELEMENTWISE:
        _elementwise(_elementwise_in(step), memory)
    elif operation == _NORMALISE:
        _normalise(_normalise_in(step), memory)
    elif operation == _SOFTMAX:
        _softmax(_softmax_in(step), memory)
    elif operation == _COPY:
        _copy(_copy_in(step), memory)
    else:
        _sum(_sum_in(step), memory)


@compiled
def evaluate(plan, scratch, windows, result):  # type: ignore[no-untyped-def]
    """Fills the rows of a result with what a program makes of windows."""
    steps, weights = array_at(plan[0, 0], plan[0, 1], np.int64), plan[1, 0]
    window, channels = plan[2, 0], plan[3, 0]
    memory = array_at(scratch[0, 0], scratch[0, 1], np.float32)
    for row in range(windows.shape[0]):
        for place in range(windows.shape[1]):
            memory[window + place] = windows[row, place]
        for first in range(0, steps.size, WORDS):
            _carry_out(steps[first : first + WORDS], memory, weights)
        for channel in range(result.shape[1]):
            result[row, channel] = memory[channels + channel]
