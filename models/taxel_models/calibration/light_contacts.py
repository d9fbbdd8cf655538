"""Contact cycles of recordings: the course of each at small forces, and the light touch at its end.

A cycle is a stretch of rows in contact whose force reaches the light limit. Its light touch comes after the
last row above the limit and ends when contact is lost. There the probe hardly dents the skin, least of all
in the last position, which is taken. Its course is all its positions at forces that dent the skin in a
known way.

A tracker may be slower than the rows. Then several rows hold one position, and the first of them has the
force that belongs to it.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray

from taxel.errors import RecordingError
from taxel_models.calibration.limits import Limits
from taxel_models.recordings import Recording

HERTZ_N: Final = 1.0
"""Up to about this force a press follows Hertz's law. At larger forces the core stiffens the skin."""

FEWEST: Final = 20
"""Light contacts needed: about three for each of the components that are fitted."""

ORIENTATION: Final = tuple(f"probe.orientation.{axis}" for axis in "xyzw")
"""Columns of the probe's orientation, a quaternion from its frame to the recorded one, if recorded."""

_HELD_MM: Final = 1e-6
"""A position that differs by less from the one before counts as the same position."""


@dataclass(frozen=True)
class LightContacts:
    """n contact cycles with m positions in all, in the recorded frame.

    Attributes:
        course: (m, 3), the tracked point, one contact after the other, mm; each contact's last is its
            light touch.
        force: (m,), size of the force there, N.
        starts: (n,), the index in `course` where each contact begins.
        first: (n, 3), the tracked point when the force first exceeded the light limit, mm.
        course_orientation: (m, 4), the probe's quaternions, x y z w; none if not recorded.
        first_orientation: (n, 4), likewise at `first`.
    """

    course: NDArray[np.float64]
    force: NDArray[np.float64]
    starts: NDArray[np.int64]
    first: NDArray[np.float64]
    course_orientation: NDArray[np.float64] | None = None
    first_orientation: NDArray[np.float64] | None = None

    @classmethod
    def of(cls, recordings: Sequence[Recording], limits: Limits) -> Self:
        """The light contacts of recordings in one frame.

        The probe's orientation is used if all recordings have the columns `ORIENTATION`.

        Raises:
            RecordingError: there are too few, or a quaternion is zero.
        """
        oriented = all(set(ORIENTATION) <= set(recording.covariates) for recording in recordings)
        cycles = [list(_cycles(recording, limits)) for recording in recordings]
        count = sum(map(len, cycles))
        if count < FEWEST:
            raise RecordingError(
                f"{', '.join(recording.name for recording in recordings)}: {count} contact cycles end in "
                f"a light touch (force between {limits.touch:g} and {limits.light:g} N, then none); "
                f"expected at least {FEWEST}"
            )
        pairs = list(zip(recordings, cycles, strict=True))
        first = [
            (recording, np.array([cycle.first for cycle in found], dtype=np.int64))
            for recording, found in pairs
        ]
        course = [
            (recording, np.concatenate([np.empty(0, np.int64), *(cycle.course for cycle in found)]))
            for recording, found in pairs
        ]
        lengths = [len(cycle.course) for found in cycles for cycle in found]
        return cls(
            course=_positions(course),
            force=np.concatenate([_force(recording)[rows] for recording, rows in course]),
            starts=np.concatenate([[0], np.cumsum(lengths[:-1], dtype=np.int64)]),
            first=_positions(first),
            course_orientation=_orientations(course) if oriented else None,
            first_orientation=_orientations(first) if oriented else None,
        )

    @property
    def ends(self) -> NDArray[np.int64]:
        """(n,), the indices of the light touches in `course`."""
        return np.append(self.starts[1:], len(self.course)) - 1

    @property
    def position(self) -> NDArray[np.float64]:
        """(n, 3), the tracked point in the light touch, mm."""
        return self.course[self.ends]

    @property
    def orientation(self) -> NDArray[np.float64] | None:
        """(n, 4), the probe's quaternion in the light touch, x y z w; none if not recorded."""
        return None if self.course_orientation is None else self.course_orientation[self.ends]

    def __len__(self) -> int:
        return len(self.starts)


@dataclass(frozen=True)
class _Cycle:
    """Rows of a contact: the first above the light limit, and those of its course."""

    first: int
    course: NDArray[np.int64]


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


def _force(recording: Recording) -> NDArray[np.float64]:
    return np.asarray(np.linalg.norm(recording.samples.force, axis=1))


def _cycles(recording: Recording, limits: Limits) -> Iterator[_Cycle]:
    """Each whole cycle that ends in a light touch with a position of its own."""
    force = _force(recording)
    moved = np.abs(np.diff(recording.samples.position * 1e3, axis=0)).max(axis=1, initial=0.0)
    new = np.concatenate([[True], moved > _HELD_MM])
    new[[segment.start for segment in recording.segments]] = True
    follows_hertz = force < max(HERTZ_N, limits.light)
    for segment in recording.segments:
        touched = np.concatenate([[False], force[segment] > limits.touch, [False]])
        edges = segment.start + np.flatnonzero(np.diff(touched.astype(np.int8)))
        for start, stop in edges.reshape(-1, 2).tolist():
            strong = start + np.flatnonzero(force[start:stop] >= limits.light)
            course = start + np.flatnonzero((new & follows_hertz)[start:stop])
            if len(strong) and len(course) and strong[-1] < course[-1] and stop < segment.stop:
                yield _Cycle(int(strong[0]), course)
