"""A corrected model: a base model's prediction, and the effects that it lacks."""

from collections.abc import Callable, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from taxel.channels import CHANNELS
from taxel.corrections.compose import Composition
from taxel.corrections.effect import AppliedEffect
from taxel.windows import ExtraFeature, WindowSpec

_BLOCK: Final = 256
"""Rows that terms are computed on at a time: larger intermediate arrays cost far more than they hold."""

Evaluate = Callable[[NDArray[np.float32]], NDArray[np.float32]]
"""The base model: windows (n, k) float32, C-contiguous, to counts (n, 21) or with a spread (n, 42)."""


class Correction:
    """Effects in the order in which they were added, ready to be applied. Thread-safe.

    Shifts are the window builder's business: windows come built with `spec`. Frames are applied
    the newest first, because each was fitted in front of the model corrected so far.

    Args:
        effects: of `manifest.effects`.
        spec: of the windows, with its shift.
        extras: what follows a window's own features: the model's, then the effects'.
    """

    def __init__(
        self, effects: Sequence[AppliedEffect], spec: WindowSpec, extras: Sequence[ExtraFeature]
    ) -> None:
        self._spec = spec
        self._frames = [effect.frame for effect in reversed(effects) if effect.frame is not None]
        self._composition = Composition(term for effect in effects for term in effect.terms)
        names = [*spec.unshifted.features, *(extra.name for extra in extras)]
        taken = {name for effect in effects for name in effect.takes}
        self._columns = {name: column for column, name in enumerate(names) if name in taken}
        self._model_columns = spec.length + sum(extra.taken_by == "model" for extra in extras)

    def base(self, evaluate: Evaluate, windows: NDArray[np.float32]) -> NDArray[np.float32]:
        """What the base model gives to the windows, as the frames turn them.

        Args:
            evaluate: the base model.
            windows: (n, f), with all extras.

        Returns:
            What `evaluate` returns: (n, 21) float32 counts, or (n, 42) with the spread.
        """
        inputs = windows[:, : self._model_columns]
        for frame in self._frames:
            inputs = frame.turn(inputs, self._spec)
        return evaluate(np.ascontiguousarray(inputs))

    def apply(self, evaluate: Evaluate, windows: NDArray[np.float32]) -> NDArray[np.float32]:
        """Counts of windows, corrected.

        Args:
            evaluate: the base model.
            windows: (n, f), with all extras.

        Returns:
            (n, 21) float32, or (n, 42) with the base model's spread as it stands.
        """
        return self.add(self.base(evaluate, windows), windows)

    def add(self, base: NDArray[np.float32], windows: NDArray[np.float32]) -> NDArray[np.float32]:
        """The base model's counts with the terms added.

        Args:
            base: (n, 21) or (n, 42), as `base` gives it.
            windows: (n, f), with all extras.

        Returns:
            A new array of the same shape.
        """
        corrected = base.copy()
        for first in range(0, len(windows), _BLOCK):
            block = slice(first, first + _BLOCK)
            p = base[block, : len(CHANNELS)].astype(np.float64)
            wide = windows[block].astype(np.float64)
            columns = {name: wide[:, column] for name, column in self._columns.items()}
            corrected[block, : len(CHANNELS)] = self._composition.counts(p, columns)
        return corrected
