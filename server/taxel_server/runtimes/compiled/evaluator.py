"""Evaluators: a compiled function with its arguments and memory, for forests and networks."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from taxel_server.runtimes.compiled.arguments import Scratch


class Evaluator(Protocol):
    """A model ready to evaluate; safe to call from any thread."""

    @property
    def name(self) -> str:
        """The evaluator's name, such as `leaf-blocks`."""

    def evaluate(self, windows: NDArray[np.float32], result: NDArray[np.float32]) -> None:
        """Fills `result` (n, outputs) with what the model says of `windows` (n, features)."""


class CompiledEvaluator(ABC):
    """A model compiled for some number of rows."""

    name: str

    def __init__(self, evaluation: Callable[..., None], arguments: NDArray[np.int64]) -> None:
        """Keeps a compiled function of four arguments: these, those of a scratch, windows, and a result."""
        self._evaluation = evaluation
        self._arguments = arguments
        self._idle = list[Scratch]()

    @abstractmethod
    def _scratch(self) -> Scratch:
        """Memory for one evaluation at a time."""

    def evaluate(self, windows: NDArray[np.float32], result: NDArray[np.float32]) -> None:
        """Fills `result` (n, outputs) with what the model says of `windows` (n, features)."""
        # Numba compiles a function anew for each kind of array: windows from the network may be read-only
        # and not aligned.
        flags = windows.flags
        if flags.writeable or not flags.aligned:
            windows = windows.view() if flags.aligned else windows.copy()
            windows.flags.writeable = False
        # A list's operations are atomic. They cost less than a lock or memory for each thread.
        try:
            scratch = self._idle.pop()
        except IndexError:
            scratch = self._scratch()
        self._evaluation(self._arguments, scratch.arguments, windows, result)
        self._idle.append(scratch)
