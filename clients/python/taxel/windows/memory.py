"""The history features of a live stream: the numbers of `history_columns`, one tick at a time."""

from collections import deque
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from taxel.windows.history import HistoryFeature, Lagged, Recursive, followed


class Memory:
    """History features of fingertips that are sampled together.

    Args:
        features: in column order.
    """

    def __init__(self, features: Sequence[HistoryFeature]) -> None:
        self._features = tuple(features)
        self._rules = {
            column: feature.rule()
            for column, feature in enumerate(features)
            if isinstance(feature, Recursive)
        }
        longest = max((feature.lag for feature in features if isinstance(feature, Lagged)), default=0)
        self._recent: deque[NDArray[np.float64]] = deque(maxlen=longest + 1)
        self._states: dict[int, list[tuple[float, float]]] = {}
        """Of each recursive feature: a state for each fingertip, and what it followed."""

    def restart(self) -> None:
        """Forget the past: the next tick is a segment's first."""
        self._recent.clear()
        self._states.clear()

    def step(self, tick: NDArray[np.float64]) -> NDArray[np.float64]:
        """Take the next tick and return its features.

        Args:
            tick: (fingers, 7), as in `taxel.windows.history`. It is kept, so do not change it.

        Returns:
            (fingers, m).
        """
        self._recent.append(tick)
        values = np.empty((len(tick), len(self._features)))
        for column, feature in enumerate(self._features):
            if isinstance(feature, Recursive):
                u = followed(feature.of, tick)
                state = self._followed(column, u) if column in self._states else feature.started(u).tolist()
                self._states[column] = list(zip(state, u.tolist(), strict=True))
                values[:, column] = feature.value(np.array(state), u)
            elif isinstance(feature, Lagged):
                before = self._recent[-1 - min(feature.lag, len(self._recent) - 1)]
                values[:, column] = feature.value(tick, before)
            else:
                values[:, column] = feature.column(tick)
        return values

    def _followed(self, column: int, u: NDArray[np.float64]) -> list[float]:
        """The new state of a recursive feature, one number for each fingertip."""
        last, rule = self._states[column], self._rules[column]
        return [rule(*state, (value,))[0] for state, value in zip(last, u.tolist(), strict=True)]
