"""Frame: the recorded forces or positions are turned, shifted or scaled."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from itertools import product
from typing import Final

import numpy as np
from typing_extensions import override

from taxel.windows.history import TICK_S
from taxel_models.loop.basis import Floats, Own
from taxel_models.loop.effects.effect import Candidate, Effect, Fitting, Online, Remaining
from taxel_models.loop.effects.rigid_motion import MOTION_KINDS, Misfit, Motion, fit_motion, rows_of
from taxel_models.loop.observations import Observations, runs
from taxel_models.loop.running_mean import mean_within
from taxel_models.model import predict_all

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
        "turning, mirroring, shifting or scaling the inputs explains all channels with at most three "
        "parameters"
    )

    @override
    def forms(self, observations: Observations, remaining: Remaining) -> Iterable[Candidate]:
        found = fit_motion(observations, remaining)
        if found is not None:
            for form, part in _whole_and_slow(observations, found, _change(observations, found)):
                yield Candidate(
                    self.name,
                    form,
                    Own(part[:, :, None].astype(np.float32)),
                    fitting=Fitting(fixed=True, beforehand=len(found.vector), choices=len(MOTION_KINDS)),
                    form_parameters=found.kind.parameters(found.vector),
                    online=partial(_online, found),
                    moved=partial(_moved, found),
                )
        yield from self._slipped(observations, remaining, 0.0 if found is None else found.explained)

    @override
    @classmethod
    def why_only_reported(cls, form: str) -> str:
        return "it came about while this was recorded; set right how the finger is mounted"

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
        change = _change(observations, found)
        begins, takes, explained_by_course = _course_of(observations, change, remaining)
        if explained >= MOST_OF_IT * explained_by_course:
            return
        change *= _course(time_s, begins, takes)[:, None]
        when = {"begins": (begins, "s"), "takes": (takes, "s")}
        parameters = found.kind.parameters(found.vector) | when
        for name, part in _whole_and_slow(observations, found, change):
            yield self._reported(part, name, parameters, len(found.vector))

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
            fitting=Fitting(
                fixed=True, beforehand=motion + 2, choices=len(MOTION_KINDS), compared=len(BEGINS)
            ),
            form_parameters=parameters,
            ages=True,
            again=lambda _: self._reported(change, name, parameters, motion),
        )


def _change(observations: Observations, motion: Motion) -> Floats:
    """(n, 21) what a motion of the inputs changes in the prediction, counts."""
    turned = motion.frame.turn(observations.windows, observations.manifest.spec)
    return predict_all(observations.model.predict, turned) - observations.predicted


def _whole_and_slow(
    observations: Observations, motion: Motion, change: Floats
) -> Iterator[tuple[str, Floats]]:
    """A change (n, 21): all of it, and less what comes and goes within a second of a segment."""
    yield motion.kind.name, change
    slow = mean_within(change, SLOW_ROWS, runs(observations.segment))
    yield f"{motion.kind.name}, seen in slow changes", slow


def _course(time_s: Floats, begins: float, takes: float) -> Floats:
    """(n,) how far a motion has come about: from 0 to 1."""
    return np.clip((time_s - begins) / max(takes, TICK_S), 0.0, 1.0)


def _course_of(
    observations: Observations, change: Floats, remaining: Remaining
) -> tuple[float, float, float]:
    """When a whole change (n, 21) begins and how long it takes, s, and what it takes off the squares."""
    rows = rows_of(remaining.fit)
    time_s, end = observations.time_s, float(observations.time_s.max())
    misfit = Misfit(observations, remaining, rows)

    def left(times: tuple[float, float]) -> float:
        course = _course(time_s[rows], *times)[:, None]
        return float(misfit.of(misfit.weighted(course * change[rows])[None])[0])

    least, times = min((left(times), times) for times in product(end * BEGINS, end * TAKES))
    return *times, misfit.energy - least


def _online(motion: Motion, weights: Floats) -> Online:
    del weights
    return Online(frame=motion.frame)


def _moved(motion: Motion, observations: Observations) -> Observations:
    """The observations with turned windows. Windows that are turned already are turned further."""
    windows = motion.frame.turn(observations.windows, observations.manifest.spec)
    return observations.with_windows(windows, shift_ticks=observations.shift_ticks)
