"""Executes a program's steps on a window. It is compiled once for all networks."""

from collections.abc import Callable
from typing import Final

import numpy as np
from numpy.typing import NDArray

from taxel_server.runtimes.compiled.arguments import array_in, number_in
from taxel_server.runtimes.compiled.compiling import any_order, compiled, strict
from taxel_server.runtimes.networks.activations import (
    clip,
    elu,
    exponential,
    gelu,
    leaky_relu,
    relu,
    sigmoid,
    tanh,
)
from taxel_server.runtimes.networks.panels import FIXED_POINT, LANES, MOST_ROWS, multiply_panel
from taxel_server.runtimes.networks.program import RECORD, Operation, Step

Floats = NDArray[np.float32]
_Kernel = Callable[[Step, Floats], None]

_ZERO: Final = np.float32(0)
_ONE: Final = np.float32(1)


@strict
def _dense(step: Step, start: int, weights: int) -> None:
    """A dense layer, panel after panel. The last columns come first: panels may write behind a row."""
    values, panel = start + 4 * step.left, weights + step.weights
    for column in range((step.columns - 1) // LANES * LANES, -1, -LANES):
        result = start + 4 * (step.result + column)
        if step.rows == 1:
            multiply_panel(FIXED_POINT, values, 0, panel, step.terms, result, 0)
            panel += LANES * (3 * step.terms + 8)
        else:
            _rows_on_panel(step, values, 4 * step.terms, panel, result)
            panel += LANES * (4 * step.terms + 8)


@strict
def _rows_on_panel(step: Step, values: int, stride: int, panel: int, result: int) -> None:
    """Multiplies all rows with one panel of float32, in groups of about the same size."""
    groups = -(-step.rows // MOST_ROWS)
    first, apart = 0, 4 * step.columns
    for group in range(groups):
        after = step.rows * (group + 1) // groups
        source, target = values + stride * first, result + apart * first
        multiply_panel(after - first, source, stride, panel, step.terms, target, apart)
        first = after


@strict
def _product(step: Step, memory: Floats, start: int) -> None:
    """Products of matrices. The columns of the right matrix are copied to a panel first."""
    for group in range(step.groups):
        values = start + 4 * (step.left + group * step.left_group)
        for column in range((step.columns - 1) // LANES * LANES, -1, -LANES):
            first = step.right + group * step.right_group + column * step.right_column
            for term in range(step.terms):
                source, place = first + term * step.right_term, step.panel + term * LANES
                for lane in range(min(LANES, step.columns - column)):
                    memory[place + lane] = memory[source + lane * step.right_column]
            result = start + 4 * (step.result + group * step.rows * step.columns + column)
            _rows_on_panel(step, values, 4 * step.left_row, start + 4 * step.panel, result)


@strict
def _copy(step: Step, memory: Floats) -> None:
    """Copies a tensor of three axes with any strides to a contiguous one."""
    place = step.result
    for group in range(step.groups):
        for row in range(step.rows):
            first = step.left + group * step.left_group + row * step.left_row
            for column in range(step.columns):
                memory[place + column] = memory[first + column * step.left_column]
            place += step.columns


@any_order
def _softmax(step: Step, memory: Floats) -> None:
    """Softmax of rows. The exponentials of all rows are computed together, because rows are short."""
    width = step.columns
    size = step.rows * width
    result, values = memory[step.result : step.result + size], memory[step.left : step.left + size]
    for first in range(0, size, width):
        greatest = values[first]
        for place in range(first, first + width):
            greatest = max(greatest, values[place])
        for place in range(first, first + width):
            result[place] = values[place] - greatest
    for place in range(size):
        result[place] = exponential(result[place])
    for first in range(0, size, width):
        total = _ZERO
        for place in range(first, first + width):
            total += result[place]
        share = _ONE / total
        for place in range(first, first + width):
            result[place] *= share


@any_order
def _normalise_row(result: Floats, values: Floats, parameters: Floats) -> None:
    width = values.size
    weight, bias, epsilon = parameters[:width], parameters[width : 2 * width], parameters[2 * width]
    total = _ZERO
    for place in range(width):
        total += values[place]
    mean = total / np.float32(width)
    total = _ZERO
    for place in range(width):
        total += (values[place] - mean) * (values[place] - mean)
    factor = _ONE / np.sqrt(total / np.float32(width) + epsilon)
    for place in range(width):
        result[place] = (values[place] - mean) * factor * weight[place] + bias[place]


@strict
def _normalise(step: Step, memory: Floats) -> None:
    """Layer normalisation of rows."""
    width = step.columns
    parameters = memory[step.right : step.right + 2 * width + 1]
    for first in range(0, step.rows * width, width):
        result = memory[step.result + first : step.result + first + width]
        _normalise_row(result, memory[step.left + first : step.left + first + width], parameters)


@strict
def _arithmetic(step: Step, memory: Floats) -> None:
    """Adds, subtracts, multiplies or divides each row of the left tensor by the right tensor's one row."""
    width = step.columns
    right = memory[step.right : step.right + width]
    for first in range(0, step.rows * width, width):
        result = memory[step.result + first : step.result + first + width]
        left = memory[step.left + first : step.left + first + width]
        if step.operation == Operation.ADD:
            for place in range(width):
                result[place] = left[place] + right[place]
        elif step.operation == Operation.SUB:
            for place in range(width):
                result[place] = left[place] - right[place]
        elif step.operation == Operation.MUL:
            for place in range(width):
                result[place] = left[place] * right[place]
        else:
            for place in range(width):
                result[place] = left[place] / right[place]


def _each(function: Callable[[np.float32, np.float32, np.float32], np.float32]) -> _Kernel:
    """Compiles a step that applies a function to every value."""

    @strict
    def apply(step: Step, memory: Floats) -> None:
        result = memory[step.result : step.result + step.columns]
        values = memory[step.left : step.left + step.columns]
        alpha, beta = memory[step.right], memory[step.right + 1]
        for place in range(step.columns):
            result[place] = function(values[place], alpha, beta)

    return apply


_relu, _leaky_relu, _clip, _tanh = _each(relu), _each(leaky_relu), _each(clip), _each(tanh)
_sigmoid, _elu, _gelu = _each(sigmoid), _each(elu), _each(gelu)


@strict
def _carry_out(step: Step, memory: Floats, start: int, weights: int) -> None:  # noqa: C901
    if step.operation == Operation.DENSE:
        _dense(step, start, weights)
    elif step.operation == Operation.PRODUCT:
        _product(step, memory, start)
    elif step.operation == Operation.COPY:
        _copy(step, memory)
    elif step.operation == Operation.SOFTMAX:
        _softmax(step, memory)
    elif step.operation == Operation.NORMALISE:
        _normalise(step, memory)
    elif step.operation <= Operation.DIV:
        _arithmetic(step, memory)
    elif step.operation == Operation.RELU:
        _relu(step, memory)
    elif step.operation == Operation.LEAKYRELU:
        _leaky_relu(step, memory)
    elif step.operation == Operation.CLIP:
        _clip(step, memory)
    elif step.operation == Operation.TANH:
        _tanh(step, memory)
    elif step.operation == Operation.SIGMOID:
        _sigmoid(step, memory)
    elif step.operation == Operation.ELU:
        _elu(step, memory)
    else:
        _gelu(step, memory)


@compiled
def evaluate(
    program: NDArray[np.int64], scratch: NDArray[np.int64], windows: Floats, result: Floats
) -> None:
    """Executes a program on each window and writes the channels to the rows of the result.

    Args:
        program: the program's steps and weights, and the places of the window and of the channels, packed.
        scratch: a copy of the program's memory, packed.
        windows: (n, f) float32.
        result: (n, 21) float32, which is written.
    """
    steps, weights = array_in(program, 0, RECORD), number_in(program, 1)
    window, channels = number_in(program, 2), number_in(program, 3)
    memory = array_in(scratch, 0, np.float32)
    for row in range(windows.shape[0]):
        for place in range(windows.shape[1]):
            memory[window + place] = windows[row, place]
        for number in range(steps.size):
            _carry_out(steps[number], memory, scratch[0, 0], weights)
        for channel in range(result.shape[1]):
            result[row, channel] = memory[channels + channel]
