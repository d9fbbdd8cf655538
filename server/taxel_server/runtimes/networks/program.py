"""A network as a list of steps on one window, and the memory in which they take place."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import prod
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from taxel_server.runtimes.networks.operations import KINDS, WORDS, Dense, Place, Product, Step
from taxel_server.runtimes.networks.panels import LANES, MOST_ROWS, Panels

_LINE: Final = 64
"""Bytes of a cache line: each buffer starts with one, and each layer's weights do."""

_FLOATS_IN_A_LINE: Final = _LINE // 4


@dataclass(frozen=True)
class Value:
    """A tensor in a buffer; reshaping, transposing and slicing move no numbers.

    Attributes:
        strides: floats from one entry of an axis to the next.
    """

    place: Place
    shape: tuple[int, ...]
    strides: tuple[int, ...]

    @property
    def size(self) -> int:
        """How many numbers it has."""
        return prod(self.shape)

    @property
    def contiguous(self) -> bool:
        """Whether its numbers lie one after the other."""
        axes = zip(self.shape, self.strides, dense_strides(self.shape), strict=True)
        return all(size == 1 or apart == expected for size, apart, expected in axes)


class Program(NamedTuple):
    """A network for one window.

    Attributes:
        steps: (n, `WORDS`); places are floats behind the start of the memory.
        weights: of all dense layers.
        memory: its content before the first window: constants, and room for what is computed.
        window: where the window goes.
        channels: where the result is found.
    """

    steps: NDArray[np.int64]
    weights: NDArray[np.uint8]
    memory: NDArray[np.float32]
    window: int
    channels: int


@dataclass
class Draft:
    """A program that is being written."""

    _sizes: list[int] = field(default_factory=list)
    _constants: dict[int, NDArray[np.float32]] = field(default_factory=dict)
    _steps: list[Step] = field(default_factory=list)
    _weights: list[NDArray[np.uint8]] = field(default_factory=list)
    _bytes: int = 0
    _common: Place | None = None

    def room(self, *shape: int) -> Value:
        """A new buffer for a tensor."""
        self._sizes.append(prod(shape))
        return Value(Place(len(self._sizes) - 1), shape, dense_strides(shape))

    def constant(self, content: NDArray[np.float32]) -> Value:
        """A buffer that keeps its content."""
        value = self.room(*content.shape)
        self._constants[value.place.buffer] = np.ascontiguousarray(content, np.float32).reshape(-1)
        return value

    def step(self, step: Step) -> None:
        """Adds a step."""
        self._steps.append(step)

    def dense(self, value: Value, rows: int, columns: int, panels: Panels, bias: Value) -> Value:
        """Adds a dense layer on rows of a contiguous tensor; the bias fills whole panels."""
        result, scale = self.room(rows, columns), self.constant(panels.scale)
        self.step(
            Dense(
                result=result.place,
                values=value.place,
                weights=self._bytes,
                scale=scale.place,
                bias=bias.place,
                spare=self._shared(2),
                rows=rows,
                terms=value.size // rows,
                columns=columns,
                bits=panels.bits,
            )
        )
        content = np.zeros(-(-panels.content.size // _LINE) * _LINE, np.uint8)
        content[: panels.content.size] = panels.content
        self._weights.append(content)
        self._bytes += content.size
        return result

    def product(self, result: Value, left: Value, right: Value, groups: tuple[int, int, int]) -> None:
        """Adds products of matrices: how many, and floats from one to the next left and right."""
        count, left_apart, right_apart = groups
        terms = right.shape[-2]
        self.step(
            Product(
                result=result.place,
                left=left.place,
                right=right.place,
                groups=count,
                rows=left.shape[-2],
                terms=terms,
                columns=right.shape[-1],
                left_apart=left_apart,
                left_row=left.strides[-2],
                right_apart=right_apart,
                right_term=right.strides[-2],
                right_column=right.strides[-1],
                panel=self.room(terms, LANES).place,
                common=self._shared(0),
            )
        )

    def _shared(self, panels: int) -> Place:
        """Behind so many panels' rows of: ones, zeros, and room for `MOST_ROWS` rows."""
        if self._common is None:
            content = np.zeros((2 + MOST_ROWS, LANES), np.float32)
            content[0] = 1
            self._common = self.constant(content).place
        return Place(self._common.buffer, panels * LANES)

    def finish(self, window: Value, channels: Value) -> Program:
        """The program, its buffers laid out: those that are never needed together share memory."""
        starts = self._laid_out(window.place.buffer, channels.place.buffer)
        ends = (start + _whole(self._sizes[buffer]) for buffer, start in starts.items())
        memory = np.zeros(max(ends), np.float32)
        for buffer, content in self._constants.items():
            memory[starts[buffer] : starts[buffer] + content.size] = content
        steps = np.zeros((len(self._steps), WORDS), np.int64)
        for row, step in zip(steps, self._steps, strict=True):
            row[0] = KINDS.index(type(step))
            row[1 : 1 + len(step)] = [_word(word, starts) for word in step]
        # Never empty, even without a dense layer.
        weights = np.concatenate([*self._weights, np.zeros(_LINE, np.uint8)])
        return Program(steps, weights, memory, _word(window.place, starts), _word(channels.place, starts))

    def _laid_out(self, window: int, channels: int) -> Mapping[int, int]:
        """Where each buffer starts: constants first, then the others, first come, first fit."""
        first, last = self._lifetimes()
        for buffer in {window, channels} - self._constants.keys():
            first.setdefault(buffer, 0)
            last.setdefault(buffer, 0)
        first[window], last[channels] = -1, len(self._steps)
        starts, end = {}, 0
        for buffer in self._constants:
            starts[buffer], end = end, end + _whole(self._sizes[buffer])
        living: list[int] = []
        for buffer in sorted(first, key=lambda each: first[each]):
            living = [other for other in living if last[other] >= first[buffer]]
            taken = [(starts[other], _whole(self._sizes[other])) for other in living]
            starts[buffer] = _gap(end, _whole(self._sizes[buffer]), taken)
            living.append(buffer)
        return starts

    def _lifetimes(self) -> tuple[dict[int, int], dict[int, int]]:
        """The first and last step that each buffer takes part in, but for constants."""
        first: dict[int, int] = {}
        last: dict[int, int] = {}
        for number, step in enumerate(self._steps):
            for word in step:
                if isinstance(word, Place) and word.buffer not in self._constants:
                    first.setdefault(word.buffer, number)
                    last[word.buffer] = number
        return first, last


def dense_strides(shape: Sequence[int]) -> tuple[int, ...]:
    """Strides of a tensor whose numbers lie one after the other."""
    return tuple(prod(shape[axis + 1 :]) for axis in range(len(shape)))


def _whole(size: int) -> int:
    """Floats of whole cache lines."""
    return -(-size // _FLOATS_IN_A_LINE) * _FLOATS_IN_A_LINE


def _gap(start: int, size: int, taken: list[tuple[int, int]]) -> int:
    """The first place from a start on where so many floats are free."""
    for other, other_size in sorted(taken):
        if other - start >= size:
            break
        start = max(start, other + other_size)
    return start


def _word(word: int | Place, starts: Mapping[int, int]) -> int:
    return starts[word.buffer] + word.offset if isinstance(word, Place) else int(word)
