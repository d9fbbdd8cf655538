"""Contact cycles of recordings: where each begins, and the light touch with which it ends.

A cycle is a stretch of rows in contact whose force reaches the light limit. Its light touch is what
comes after the last row above the limit, until contact is lost: there the probe hardly dents the skin,
least of all in the last row, which is the one that is taken.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray

from taxel.errors import RecordingError, SettingsError
from taxel_models.recordings import Recording

LIGHT_N: Final = 0.3
"""A contact is light below this force (the paper)."""

TOUCH_N: Final = 0.05
"""Above this force a row is in contact."""

FEWEST: Final = 20
"""Light contacts needed: about three for each of the components that are fitted."""

ORIENTATION: Final = tuple(f"probe.orientation.{axis}" for axis in "xyzw")
"""Columns of the probe's orientation, a quaternion from its frame to the recorded one, if recorded."""


@dataclass(frozen=True)
class Limits:
    """Forces, N, that tell contact from none and light from strong.

    Raises:
        SettingsError: they are not in order.
    """

    touch: float = TOUCH_N
    light: float = LIGHT_N

    def __post_init__(self) -> None:
        if not 0 < self.touch < self.light:
            raise SettingsError(f"touch {self.touch} N, light {self.light} N: expected 0 < touch < light")


@dataclass(frozen=True)
class LightContacts:
    """One row a contact cycle, in the recorded frame.

    Attributes:
        position: (n, 3), the tracked point in the light touch, mm.
        first: (n, 3), the tracked point when the force first exceeded the light limit, mm.
        orientation: (n, 4), the probe's quaternion in the light touch, x y z w; none if not recorded.
        first_orientation: (n, 4), likewise at `first`.
    """

    position: NDArray[np.float64]
    first: NDArray[np.float64]
    orientation: NDArray[np.float64] | None = None
    first_orientation: NDArray[np.float64] | None = None

    @classmethod
    def of(cls, recordings: Sequence[Recording], limits: Limits) -> Self:
        """The light contacts of recordings in one frame.

        The probe's orientation is used where all recordings have the columns `ORIENTATION`.

        Raises:
            RecordingError: there are too few, or a quaternion is zero.
        """
        oriented = all(set(ORIENTATION) <= set(recording.covariates) for recording in recordings)
        rows = [list(_cycles(recording, limits)) for recording in recordings]
        count = sum(map(len, rows))
        if count < FEWEST:
            raise RecordingError(
                f"{', '.join(recording.name for recording in recordings)}: {count} contact cycles end in "
                f"a light touch (force between {limits.touch:g} and {limits.light:g} N, then none); "
                f"expected at least {FEWEST}"
            )
        numbered = [np.array(pairs, dtype=np.int64).reshape(-1, 2) for pairs in rows]
        first, last = (
            [(recording, pairs[:, end]) for recording, pairs in zip(recordings, numbered, strict=True)]
            for end in (0, 1)
        )
        return cls(
            position=_positions(last),
            first=_positions(first),
            orientation=_orientations(last) if oriented else None,
            first_orientation=_orientations(first) if oriented else None,
        )

    def __len__(self) -> int:
        return len(self.position)


_Rows = Sequence[tuple[Recording, NDArray[np.int64]]]


def _positions(rows: _Rows) -> NDArray[np.float64]:
    return np.concatenate([recording.samples.position[chosen] * 1e3 for recording, chosen in rows])


def _orientations(rows: _Rows) -> NDArray[np.float64]:
    parts = []
    for recording, chosen in rows:
        turns = np.column_stack([recording.covariates[name][chosen] for name in ORIENTATION])
        if not turns.any(axis=1).all():
            row = int(chosen[np.argmin(turns.any(axis=1))])
            raise RecordingError(
                f"{recording.name}: the probe's orientation in row {row} is zero; expected a quaternion"
            )
        parts.append(turns)
    return np.concatenate(parts)


def _cycles(recording: Recording, limits: Limits) -> Iterator[tuple[int, int]]:
    """Of each whole cycle: its first row above the light limit, and the last row of its light touch."""
    force = np.linalg.norm(recording.samples.force, axis=1)
    for segment in recording.segments:
        touched = np.concatenate([[False], force[segment] > limits.touch, [False]])
        edges = segment.start + np.flatnonzero(np.diff(touched.astype(np.int8)))
        for start, stop in edges.reshape(-1, 2).tolist():
            strong = start + np.flatnonzero(force[start:stop] >= limits.light)
            if len(strong) and strong[-1] + 1 < stop < segment.stop:
                yield int(strong[0]), stop - 1
