"""Programs: the steps that evaluate a network on one window, with all tensors in one memory."""

from enum import IntEnum
from math import prod
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from taxel_server.runtimes.networks.graph import Unsupported
from taxel_server.runtimes.networks.panels import LANES

_CACHE_LINE: Final = 16
"""Each tensor starts at a multiple of so many floats."""


Operation = IntEnum(
    "Operation",
    "DENSE PRODUCT COPY SOFTMAX NORMALISE ADD SUB MUL DIV RELU LEAKYRELU CLIP TANH SIGMOID ELU GELU",
)
"""What a step computes. From `ADD` on, the operations have ONNX's names."""


class Step(NamedTuple):
    """One operation on tensors; compiled code reads it as a record with the same fields.

    Places and strides count floats; a place is the distance from the start of the memory.

    Attributes:
        operation: an `Operation`.
        result: the place of the result, which is contiguous.
        left: the place of the first operand.
        right: the place of the second operand; for a normalisation, of its weight, bias and epsilon; for an
            activation, of its two parameters.
        panel: the place of memory for one panel of a product.
        weights: the start of a dense layer's panels, in bytes from the start of the weights.
        groups: the number of matrices of `rows` and `columns`; a product sums over `terms`.
        left_group: the stride from one matrix to the next; the fields after it are strides, too.
    """

    operation: int
    result: int
    left: int
    right: int = 0
    panel: int = 0
    weights: int = 0
    groups: int = 1
    rows: int = 1
    terms: int = 1
    columns: int = 1
    left_group: int = 0
    left_row: int = 0
    left_column: int = 0
    right_group: int = 0
    right_term: int = 0
    right_column: int = 0


RECORD: Final = np.dtype([(name, np.int64) for name in Step._fields])
"""The record of a step in a program."""


class Tensor(NamedTuple):
    """A tensor in the memory; transposing and slicing move no numbers.

    Attributes:
        place: the place of its first number.
        strides: the floats from one entry of an axis to the next.
    """

    place: int
    shape: tuple[int, ...]
    strides: tuple[int, ...]

    @property
    def size(self) -> int:
        """The number of its entries."""
        return prod(self.shape)

    @property
    def axes(self) -> list[tuple[int, int]]:
        """Size and stride of each axis that has more than one entry."""
        return [axis for axis in zip(self.shape, self.strides, strict=True) if axis[0] != 1]

    @property
    def contiguous(self) -> bool:
        """Whether its numbers stand one after the other, in order."""
        return self.axes == dense(self.place, self.shape).axes

    def part(self, axis: int, first: int, count: int) -> "Tensor":
        """Some entries of an axis."""
        axis %= len(self.shape)
        shape = (*self.shape[:axis], count, *self.shape[axis + 1 :])
        return Tensor(self.place + first * self.strides[axis], shape, self.strides)


def dense(place: int, shape: tuple[int, ...]) -> Tensor:
    """A contiguous tensor."""
    return Tensor(place, shape, tuple(prod(shape[axis + 1 :]) for axis in range(len(shape))))


class Program(NamedTuple):
    """A network for one window.

    Attributes:
        steps: records of `Step`, in the order of execution.
        weights: the panels of all dense layers.
        memory: the constants; zeros where the steps write.
        window: the place of the window.
        channels: the place of the channels.
    """

    steps: NDArray[Any]
    weights: NDArray[np.uint8]
    memory: NDArray[np.float32]
    window: int
    channels: int


class ProgramBuilder:
    """Collects the steps, tensors and weights of a program."""

    def __init__(self) -> None:
        self._steps = list[Step]()
        self._memory = [np.zeros(0, np.float32)]
        self._weights = [np.zeros(0, np.uint8)]

    def add(self, operation: Operation, result: Tensor, left: Tensor, **fields: int) -> None:
        """Adds a step."""
        self._steps.append(Step(operation, result.place, left.place, **fields))

    def allocate(self, *shape: int) -> Tensor:
        """A new tensor, of zeros until a step writes to it."""
        return self.constant(np.zeros(shape))

    def constant(self, content: NDArray[Any]) -> Tensor:
        """A new tensor with content. A product of panels may write to the memory behind it."""
        tensor = dense(sum(block.size for block in self._memory), content.shape)
        block = np.zeros(-(-(content.size + LANES) // _CACHE_LINE) * _CACHE_LINE, np.float32)
        block[: content.size] = content.reshape(-1)
        self._memory.append(block)
        return tensor

    def weights(self, panels: NDArray[np.uint8]) -> int:
        """Adds the panels of a dense layer and gives their place."""
        start = sum(block.size for block in self._weights)
        self._weights.append(panels)
        return start

    def contiguous(self, values: Tensor) -> Tensor:
        """The tensor itself if it is contiguous, otherwise a contiguous copy."""
        if values.contiguous:
            return values
        result = self.allocate(*values.shape)
        self.copy(result, values)
        return result

    def copy(self, result: Tensor, values: Tensor) -> None:
        """Adds a step that copies a tensor to a contiguous one.

        Raises:
            Unsupported: the tensor has more than three axes.
        """
        if len(values.axes) > 3:
            raise Unsupported(f"a tensor of shape {values.shape} in another order")
        (groups, left_group), (rows, left_row), (columns, left_column) = [
            *[(1, 0)] * (3 - len(values.axes)),
            *values.axes,
        ]
        sizes = {"groups": groups, "rows": rows, "columns": columns}
        strides = {"left_group": left_group, "left_row": left_row, "left_column": left_column}
        self.add(Operation.COPY, result, values, **sizes, **strides)

    def finish(self, window: Tensor, channels: Tensor) -> Program:
        """The program that turns a window into channels. Both tensors are contiguous."""
        return Program(
            np.array(self._steps, RECORD),
            np.concatenate(self._weights),
            np.concatenate(self._memory),
            window.place,
            channels.place,
        )
