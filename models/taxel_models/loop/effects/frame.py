"""Frame: the recorded forces or positions are turned, shifted or scaled."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from itertools import pairwise, product
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d
from typing_extensions import override

from taxel.windows.history import TICK_S
from taxel_models.loop.basis import Floats, Own
from taxel_models.loop.effects.effect import Candidate, Effect, Fitting, Online, Remaining
from taxel_models.loop.effects.rigid_motion import Misfit, after, fit_motion, rows_of, turn_of
from taxel_models.loop.observations import Observations
from taxel_models.model import predict_all

MOST_ROWS: Final = 40_000
"""The motion's change is predicted at so many rows at most, at equal steps."""

SLOW_ROWS: Final = 101
"""A second. A change less what comes and goes within it is a form of its own. A model's prediction jumps
from row to row where its inputs have noise, a forest's most of all. With moved inputs it jumps otherwise.
The noise of neighbouring rows counts much where a residual fades slowly, and hides what a motion does."""

LAST: Final = 0.4
"""The last part of the session, by which a motion is found that came about in its course."""

BEGINS: Final = np.linspace(0.05, 0.75, 15)
TAKES: Final = np.linspace(0.0, 0.3, 7)
"""Moments and durations that are tried, over the session's length."""

MOST_OF_IT: Final = 0.67
"""A motion from the start that explains this share of what one does that comes about is taken in its place:
it can be served, and a course that is fitted explains a little more in any case. The inference takes the
same share where one of two effects is simpler."""

NAMES: Final = {
    "force": "forces turned",
    "position": "positions turned",
    "shift": "positions shifted",
    "both": "both turned alike",
    "zero": "forces shifted",
    "scale": "forces scaled",
}


class FrameEffect(Effect):
    """A motion between the recorded frame and the model's frame. All channels share it.

    Forces may also have another zero or scale, where a force sensor has drifted.
    """

    name = "frame"
    looks_at_residual = True
    is_costly = True
    equation = "measured = model(R x + t, s Q F + f)"
    source = (
        "rigid motion, and a force sensor's zero and gain; Gauss-Newton on finite differences of the model"
    )
    signature = (
        "turning, shifting or scaling the inputs explains all channels with at most three parameters"
    )

    @override
    def forms(self, observations: Observations, remaining: Remaining) -> Iterable[Candidate]:
        found = fit_motion(observations, remaining)
        if found is not None:
            yield from self._always(observations, found.kind, found.vector)
        yield from self._slipped(observations, remaining, 0.0 if found is None else found.explained)

    def _always(self, observations: Observations, kind: str, vector: Floats) -> Iterable[Candidate]:
        step = -(-len(observations) // MOST_ROWS)
        rows = np.arange(0, len(observations), step)
        turned = turn_of(kind, vector).turn(observations.windows[rows], observations.manifest.spec)
        change = predict_all(observations.model.predict, turned) - observations.predicted[rows]
        for form, part in _whole_and_slow(kind, change, observations.segment[rows], step):
            yield Candidate(
                self.name,
                form,
                Own(part[:, :, None].astype(np.float32), rows),
                fitting=Fitting(fixed=True, beforehand=len(vector), choices=len(NAMES)),
                form_parameters=_form_parameters(kind, vector),
                online=partial(_online, kind, vector),
                moved=partial(_moved, kind, vector),
            )

    def _slipped(
        self, observations: Observations, remaining: Remaining, explained: float
    ) -> Iterable[Candidate]:
        """The motion of the session's last part, and the course by which it came about.

        Args:
            explained: by a motion that was there from the start.
        """
        time_s = observations.time_s
        late = time_s >= np.quantile(time_s[remaining.fit], 1.0 - LAST)
        found = fit_motion(observations, replace(remaining, fit=remaining.fit & late))
        if found is None:
            return
        kind, vector, _ = found
        turned = turn_of(kind, vector).turn(observations.windows, observations.manifest.spec)
        change = predict_all(observations.model.predict, turned) - observations.predicted
        begins, takes, explained_by_course = _course_of(observations, kind, change, remaining)
        if explained >= MOST_OF_IT * explained_by_course:
            return
        change *= _course(time_s, begins, takes)[:, None]
        parameters = _form_parameters(kind, vector) | {"begins": (begins, "s"), "takes": (takes, "s")}
        for name, part in _whole_and_slow(kind, change, observations.segment, 1):
            yield self._reported(part, name, parameters, len(vector))

    def _reported(
        self, change: Floats, name: str, parameters: Mapping[str, tuple[float, str]], motion: int
    ) -> Candidate:
        """A motion that comes about in the session: what it added is no part of a model to be served.

        Args:
            motion: its figures beside when it begins and how long it takes.
        """
        return Candidate(
            self.name,
            f"{name}, from {parameters['begins'][0]:.0f} s on",
            Own(change[:, :, None].astype(np.float32)),
            fitting=Fitting(fixed=True, beforehand=motion + 2, choices=len(NAMES), compared=len(BEGINS)),
            form_parameters=parameters,
            ages=True,
            again=lambda _: self._reported(change, name, parameters, motion),
        )


def _whole_and_slow(
    kind: str, change: Floats, segment: NDArray[np.int64], step: int
) -> Iterator[tuple[str, Floats]]:
    """A change (n, 21) at every so many rows: all of it, and less what comes and goes within a second."""
    slow, window = np.empty_like(change), max(SLOW_ROWS // step, 1)
    edges = np.flatnonzero(np.diff(segment, prepend=-1, append=-1))
    for start, stop in pairwise(edges):
        slow[start:stop] = uniform_filter1d(change[start:stop], window, axis=0, mode="nearest")
    yield NAMES[kind], change
    yield f"{NAMES[kind]}, seen in slow changes", slow


def _course(time_s: Floats, begins: float, takes: float) -> Floats:
    """(n,) how far a motion has come about: from 0 to 1."""
    return np.clip((time_s - begins) / max(takes, TICK_S), 0.0, 1.0)


def _course_of(
    observations: Observations, kind: str, change: Floats, remaining: Remaining
) -> tuple[float, float, float]:
    """When a whole change (n, 21) begins and how long it takes, s, and what it takes off the squares."""
    rows = rows_of(remaining.fit)
    time_s, end = observations.time_s, float(observations.time_s.max())
    misfit = Misfit(observations, remaining, kind, rows)

    def left(times: tuple[float, float]) -> float:
        course = _course(time_s[rows], *times)[:, None]
        return float(misfit.of(misfit.weighted(course * change[rows])[None])[0])

    least, times = min((left(times), times) for times in product(end * BEGINS, end * TAKES))
    return *times, misfit.energy - least


def _form_parameters(kind: str, vector: Floats) -> dict[str, tuple[float, str]]:
    """The motion's parameters, for a report."""
    if kind == "shift":
        named = dict(zip("xyz", vector * 1e3, strict=True))
        return {name: (float(value), "mm") for name, value in named.items()}
    if kind == "zero":
        return {f"force {name}": (float(value), "N") for name, value in zip("xyz", vector, strict=True)}
    if kind == "scale":
        return {"force scale": (1.0 + float(vector[0]), "")}
    named = dict(zip("xyz", np.degrees(vector), strict=True))
    angle = float(np.degrees(np.linalg.norm(vector)))
    return {"angle": (angle, "deg"), **{name: (float(value), "deg") for name, value in named.items()}}


def _online(kind: str, vector: Floats, weights: Floats) -> Online:
    del weights
    return Online(frame=turn_of(kind, vector))


def _moved(kind: str, vector: Floats, observations: Observations) -> Observations:
    """The observations with turned windows. Windows that are turned already are turned further."""
    turn = turn_of(kind, vector)
    windows = turn.turn(observations.windows, observations.manifest.spec)
    whole = turn if observations.turn is None else after(turn, observations.turn)
    return observations.with_windows(windows, turn=whole, shift_ticks=observations.shift_ticks)
