"""Courses: forms whose size follows a given function of the session's time."""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from scipy.linalg import block_diag

from taxel.corrections import Shape
from taxel.windows import PERIOD_NS
from taxel_models.loop.basis import Floats, Shared
from taxel_models.loop.effects.drivers import Driver, elapsed, evenly_filled, weighted
from taxel_models.loop.effects.effect import Candidate
from taxel_models.loop.observations import Observations

RECORDED: Final = 16
"""The straight pieces of a course in recorded time, with as many rows in each; pauses have their own."""

LONG_PAUSE: Final = 0.05
"""The least share of a session that counts as a pause: what changes by the clock goes on in it."""


def has_long_pauses(observations: Observations) -> bool:
    """Whether the time that was recorded differs from the clock's."""
    time = observations.time_s
    return bool((np.diff(time) > LONG_PAUSE * time.max()).any())


def recorded(observations: Observations) -> tuple[Floats, Floats]:
    """Edges of the session's time (k + 1,), s, and how much was recorded until each, s, in all sessions."""
    time = observations.time_s
    pauses = np.flatnonzero(np.diff(time) > LONG_PAUSE * time.max())
    edges = np.union1d(evenly_filled(observations, RECORDED), [time[pauses], time[pauses + 1]])
    return edges, np.searchsorted(np.sort(time), edges) * PERIOD_NS / 1e9


def along(
    observations: Observations,
    effect: str,
    form: str,
    shape: Shape,
    edges: Floats,
    course: Floats,
    *,
    beside: Sequence[Driver] = (),
    centred: bool = True,
    **others: Any,
) -> Candidate:
    """A form whose last regressor goes through given values at given times, by straight pieces.

    Args:
        edges: (k + 1,) of the session's time, s.
        course: (k + 1,) what it is there.
        beside: drivers that come before it.
        centred: as of `weighted`.
        others: fields of the candidate.
    """
    drivers = [*beside, *elapsed(observations, edges)]
    pieces = weighted(observations, effect, form, shape, drivers, centred=centred, **others)
    assert isinstance(pieces.basis, Shared)
    # From the weights of the regressors to those of the pieces.
    spread = block_diag(np.eye(len(beside)), np.diff(course)[:, None] / np.diff(edges)[:, None])
    return Candidate(
        effect,
        form,
        Shared(pieces.basis.features @ spread, pieces.basis.shape),
        online=lambda weights: pieces.online(weights @ spread.T),
        again=lambda other: along(
            other, effect, form, shape, edges, course, beside=beside, centred=centred, **others
        ),
        **others,
    )
