"""Drift: a slow function of the time since the session began."""

from collections.abc import Iterable, Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from taxel.windows.history import TICK_S
from taxel_models.loop.basis import Floats
from taxel_models.loop.effects.course import along, has_long_pauses, recorded
from taxel_models.loop.effects.drivers import elapsed, evenly_filled, weighted
from taxel_models.loop.effects.effect import Candidate, Effect, Fitting, Remaining
from taxel_models.loop.observations import Observations

PIECES: Final = 6
"""The straight pieces of a course that is no other function: enough for one swing over a session."""

STEPS: Final = np.arange(1, 32) / 32
"""Shares of the fit part before a step. Where a segment begins nearby, the step is there."""

FINER_STEPS: Final = np.array([-1, 1, -2, 2]) / 128
"""Shares around the best one."""

SHORTEST_S: Final = 60.0

WARMING: Final = (0.06, 0.15, 0.4)
"""Time constants of an exponential over the session's length; a longer one is a line."""

FINER: Final = (0.62, 0.79, 1.26, 1.6)
"""Factors of finer time constants; neighbours on the grid differ by a factor of 2.6."""

STRAIGHT: Final = 8
"""The straight pieces that an exponential is served as."""

SETTLED: Final = 6.0
"""Time constants until an exponential is constant: 0.25 % are left."""


class Drift(Effect):
    """measured = model + w_c d(t); d is a line, an exponential, a step or straight pieces.

    All channels follow one course, each with its own size: what drifts is the finger. A course of its own
    in each channel would be as free as constants of kinds that were recorded one after the other.

    A course begins at 0: the finger changes from the start of the session on. The same course less its mean
    is another form, since a model may have absorbed the mean.

    A line and an exponential are also tried in the time that was recorded: with long pauses, such as
    nights, a finger that changes while it is used does not follow the clock. d is constant after the end
    of the recording.
    """

    name = "drift"
    looks_at_residual = True
    is_steady = True
    equation = "delta_c = w_c d(t), with one course d of all channels"
    source = "warm-up of an idle finger: one exponential of 220 to 270 s (LASA recordings)"
    signature = "the residual moves with the clock, in free air as in contact, and follows no temperature"

    @override
    def forms(self, observations: Observations, remaining: Remaining) -> Iterable[Candidate]:
        time = observations.time_s
        span = float(time.max())
        if span < SHORTEST_S:
            return
        drivers = elapsed(observations, evenly_filled(observations, 1))
        yield weighted(
            observations,
            self.name,
            "line",
            "unit",
            drivers,
            centred=False,
            weight_units=("counts/s",),
            uneven=True,
        )
        yield _of_pieces(observations, remaining)
        for share in WARMING:
            yield _exponential(share * span, "s", observations)
        times = np.unique(time[remaining.fit])
        for share in _steps(times, observations).tolist():
            yield _step(share, times, observations)
        if has_long_pauses(observations):
            edges, recorded_s = recorded(observations)
            yield _along(observations, "line in recorded time", edges, recorded_s / recorded_s[-1])
            for share in WARMING:
                yield _exponential(share * float(recorded_s[-1]), "s recorded", observations)

    @override
    def finer(
        self, observations: Observations, best: Candidate, fit: NDArray[np.bool_]
    ) -> Iterable[Candidate]:
        if "time_constant" in best.form_parameters:
            tau, unit = best.form_parameters["time_constant"]
            for factor in FINER:
                yield _exponential(factor * tau, unit, observations)
        if "time" in best.form_parameters:
            times = np.unique(observations.time_s[fit])
            share = np.searchsorted(times, best.form_parameters["time"][0]) / len(times)
            for finer in (share + FINER_STEPS).tolist():
                if 0 < finer < 1:
                    yield _step(finer, times, observations)


def _of_pieces(observations: Observations, remaining: Remaining) -> Candidate:
    """Straight pieces of the course that explains most of what all channels do.

    It is the first principal component of the pieces that are fitted to each channel by least squares.
    """
    edges = evenly_filled(observations, PIECES)
    pieces = np.column_stack([driver.values for driver in elapsed(observations, edges)])
    row_weights = remaining.row_weights * remaining.fit
    left = remaining.residual - np.average(remaining.residual, axis=0, weights=row_weights)
    left = left / np.maximum(np.sqrt(np.average(left**2, axis=0, weights=row_weights)), 1e-9)
    roots = np.sqrt(row_weights)[:, None]
    regressors = roots * (pieces - np.average(pieces, axis=0, weights=row_weights))
    slopes, *_ = np.linalg.lstsq(regressors, roots * left)
    fitted = regressors @ slopes
    _, vectors = np.linalg.eigh(fitted.T @ fitted)
    course = np.concatenate([[0.0], np.cumsum(slopes @ vectors[:, -1] * np.diff(edges))])
    course /= max(float(np.abs(course).max()), 1e-12)
    fitting = Fitting(beforehand=len(edges) - 2)
    return _along(observations, f"{PIECES} straight pieces", edges, course, fitting=fitting)


def _exponential(tau: float, unit: str, observations: Observations) -> Candidate:
    """1 - exp(-t / tau), where t is the session's time (`s`), or what was recorded of it (`s recorded`)."""
    if unit == "s":
        # Knots whose density is the root of the curvature make the error of all pieces alike. A last piece
        # as long as the rest of the session would be a line to whoever sees that piece alone.
        end = min(float(observations.time_s.max()) / tau, SETTLED)
        shares = np.linspace(0.0, 1.0, STRAIGHT + 1)
        edges = -2.0 * tau * np.log1p(shares * np.expm1(-end / 2.0))
        elapsed_s = edges
    else:
        edges, elapsed_s = recorded(observations)
    course = -np.expm1(-elapsed_s / tau)
    form = f"an exponential of {tau:.3g} {unit}"
    return _along(observations, form, edges, course, {"time_constant": (tau, unit)})


def _steps(times: Floats, observations: Observations) -> Floats:
    """(m,) shares of the fit part's rows before the steps that are tried; its rows are at times (k,), s."""
    # Also at rows that are held out: a step among them is placed by `_step`.
    gaps = np.flatnonzero(np.diff(times) > 1.5 * TICK_S) + 1
    begins = np.union1d(gaps, np.searchsorted(times, _starts(observations))) / len(times)
    if not len(begins):
        return STEPS
    nearest = begins[np.abs(begins[:, None] - STEPS).argmin(axis=0)]
    near = np.abs(nearest - STEPS) < STEPS[0] / 2
    return np.unique(np.where(near, nearest, STEPS))


def _step(share: float, times: Floats, observations: Observations) -> Candidate:
    """From 0 to 1 within a tick, once a share of the fit part's times (k,), s, is over.

    Between two of these rows nothing tells when. The step is there where the only segment begins, else in
    the middle.
    """
    place = min(max(round(share * len(times)), 1), len(times) - 1)
    before, after = times[place - 1], times[place]
    starts = _starts(observations)
    starts = starts[(starts > before) & (starts <= after)]
    time = float(starts[0]) if len(starts) == 1 else max(0.5 * (before + after), before + TICK_S)
    edges, course = np.array([time - TICK_S, time]), np.array([0.0, 1.0])
    return _along(observations, f"a step at {time:.1f} s", edges, course, {"time": (time, "s")})


def _starts(observations: Observations) -> Floats:
    """(m,) when segments begin, but for the first, s."""
    return observations.time_s[np.flatnonzero(np.diff(observations.segment)) + 1]


def _along(
    observations: Observations,
    form: str,
    edges: Floats,
    course: Floats,
    parameters: Mapping[str, tuple[float, str]] | None = None,
    fitting: Fitting | None = None,
) -> Candidate:
    return along(
        observations,
        Drift.name,
        form,
        "unit",
        edges,
        course,
        centred=False,
        weight_names=("size",),
        weight_units=("counts",),
        fitting=fitting or Fitting(),
        form_parameters=parameters or {},
        uneven=True,
    )
