"""Columns of recordings that name kinds, such as the material that was touched."""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from taxel_models.recordings.recording import Recording

MOST_KINDS: Final = 32
"""A column of whole numbers with at most so many values names kinds; any other column is an amount."""

NOT_COVARIATES: Final = frozenset({"tdc", "tac", "pac1", "trial"})
"""Columns that tell nothing of the circumstances: the sensor's own, and numbers of what was recorded."""


NUMBERS: Final = frozenset({"session", "run", "episode", "day"})
"""Columns that may be covariates, but number what was recorded: that a number is new says nothing."""


def are_kinds(values: NDArray[np.float64]) -> bool:
    """Whether a column's different values name kinds."""
    return len(values) <= MOST_KINDS and bool((values == np.rint(values)).all())


def kinds_of(recordings: Sequence[Recording]) -> dict[str, tuple[float, ...]]:
    """The values of each column that names kinds in recordings; at least one recording.

    Numbers of trials or sessions are left out: every later one is new.
    A column that a recording lacks is left out: of its rows, the kind is not known.
    """
    common = set.intersection(*(set(recording.covariates) for recording in recordings))
    common -= NOT_COVARIATES | NUMBERS
    values: dict[str, NDArray[Any]] = {
        name: np.unique(np.concatenate([recording.covariates[name] for recording in recordings]))
        for name in sorted(common)
    }
    return {name: tuple(kinds.tolist()) for name, kinds in values.items() if are_kinds(kinds)}
