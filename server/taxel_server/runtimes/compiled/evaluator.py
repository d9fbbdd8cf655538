"""A compiled function with its arguments, and memory for it: what forests and networks have in common."""

from collections.abc import Callable, Sequence
from typing import Any, Protocol, Self

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from taxel_server.runtimes.compiled.arguments import Scratch, pack


class Evaluator(Protocol):
    """A model ready to evaluate; safe to call from any thread."""

    @property
    def name(self) -> str:
        """How it evaluates."""

    def evaluate(self, windows: NDArray[np.float32], result: NDArray[np.float32]) -> None:
        """Fills `result` (n, outputs) with what the model says of `windows` (n, features)."""


class CompiledEvaluator:
    """A model compiled for some number of rows.

    A pickle of it holds its data. Whoever reads it, in another process, makes it again from them: compiled
    functions and the data have other addresses there.
    """

    name: str

    def __init__(
        self,
        data: tuple[Any, ...],
        evaluation: Callable[..., None],
        arguments: Sequence[tuple[Any, ...]],
        scratch: tuple[NDArray[Any], ...],
    ) -> None:
        """Takes a function of these arguments, a scratch's arguments, windows and a result.

        Args:
            data: the arguments that this evaluator's class was called with, without copies of what
                `arguments` refers to.
            evaluation: the function.
            arguments: what its first argument packs.
            scratch: what its second argument packs: a copy of these arrays for each call at a time.
        """
        self._data = data
        self._evaluation = evaluation
        self._given = arguments  # which `pack` does not keep alive
        self._arguments = pack(*arguments)
        self._scratch = scratch
        self._idle = list[Scratch]()

    @override
    def __reduce__(self) -> tuple[type[Self], tuple[Any, ...]]:
        return type(self), self._data

    def evaluate(self, windows: NDArray[np.float32], result: NDArray[np.float32]) -> None:
        """Fills `result` (n, outputs) with what the model says of `windows` (n, features)."""
        # Numba would compile for each kind of array. An array from the network is read-only, and may
        # be unaligned in its message.
        flags = windows.flags
        if flags.writeable or not flags.aligned:
            windows = windows.view() if flags.aligned else windows.copy()
            windows.flags.writeable = False
        # A list's own operations are atomic, and cost less than a lock or a thread's own memory.
        try:
            scratch = self._idle.pop()
        except IndexError:
            scratch = Scratch(self._scratch)
        self._evaluation(self._arguments, scratch.arguments, windows, result)
        self._idle.append(scratch)
