"""What a program's steps say: a record for each operation, as a draft writes it and as `steps` reads it.

Strides and places are counted in floats; a place is in the memory of one evaluation.
"""

from dataclasses import dataclass
from enum import IntEnum
from typing import Any, Final, NamedTuple


@dataclass(frozen=True)
class Place:
    """Where a step reads or writes: a buffer, and floats behind its start. In a program, one number."""

    buffer: int
    offset: int = 0


_Place = Place | int


class Dense(NamedTuple):
    """result = values · weights · scale + bias, a row at a time; the weights are panels."""

    result: _Place
    values: _Place
    weights: int
    scale: _Place
    bias: _Place
    spare: _Place
    rows: int
    terms: int
    columns: int
    bits: int


class Product(NamedTuple):
    """result = left · right for groups of matrices; the right ones become panels first.

    `common` is where panels' rows begin: of ones, of zeros, and to spare.
    """

    result: _Place
    left: _Place
    right: _Place
    groups: int
    rows: int
    terms: int
    columns: int
    left_apart: int
    left_row: int
    right_apart: int
    right_term: int
    right_column: int
    panel: _Place
    common: _Place


class Pairwise(NamedTuple):
    """Rows of values and one row of others."""

    result: _Place
    values: _Place
    others: _Place
    rows: int
    width: int
    which: int


class Elementwise(NamedTuple):
    """A function of every value, with up to two parameters."""

    result: _Place
    values: _Place
    parameters: _Place
    size: int
    which: int


class Normalise(NamedTuple):
    """Layer normalisation of rows."""

    result: _Place
    values: _Place
    weight: _Place
    bias: _Place
    epsilon: _Place
    rows: int
    width: int


class Softmax(NamedTuple):
    """Each row's shares of its exponentials."""

    result: _Place
    values: _Place
    rows: int
    width: int


class Copy(NamedTuple):
    """A tensor of four axes, in any order, to one whose numbers lie one after the other."""

    result: _Place
    values: _Place
    size_1: int
    size_2: int
    size_3: int
    size_4: int
    stride_1: int
    stride_2: int
    stride_3: int
    stride_4: int


class Sum(NamedTuple):
    """Sums over the second of three axes."""

    result: _Place
    values: _Place
    outer: int
    middle: int
    inner: int


Step = Dense | Product | Pairwise | Elementwise | Normalise | Softmax | Copy | Sum

KINDS: Final[tuple[type[Any], ...]] = (
    *(Dense, Product, Pairwise, Elementwise),
    *(Normalise, Softmax, Copy, Sum),
)
"""The operation of each number."""

WORDS: Final = 1 + max(len(kind._fields) for kind in KINDS)
"""Of a step: its operation's number, and its record."""


class Arithmetic(IntEnum):
    """Of two values."""

    ADD = 0
    SUBTRACT = 1
    MULTIPLY = 2
    DIVIDE = 3


class Function(IntEnum):
    """Of one value: first the functions of straight pieces, then those of powers of e."""

    RELU = 0
    LEAKY_RELU = 1
    CLIP = 2
    TANH = 3
    SIGMOID = 4
    ELU = 5
    GELU = 6
