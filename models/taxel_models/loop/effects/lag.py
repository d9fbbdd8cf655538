"""Lag: channels and inputs are misaligned in time."""

from collections.abc import Iterable
from functools import partial
from typing import Final

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from taxel.windows.history import TICK_S
from taxel_models.loop.basis import Floats, Own
from taxel_models.loop.effects.effect import Candidate, Effect, Fitting, Online, Remaining
from taxel_models.loop.observations import Observations, runs
from taxel_models.loop.running_mean import mean_within

SERVED: Final = (*range(-5, 0), *range(1, 16))
"""Delays that a window moves by, ticks. Others are named and not served."""

_LONGEST: Final = 40

FAR: Final = (*range(-_LONGEST, -5, 2), *range(16, _LONGEST + 1, 2))
"""Longer delays that are tried: clocks that nobody compared."""

TICKS: Final = (*SERVED, 0.5, 1.5, *FAR)
"""Delays that are tried."""

NEAR: Final = range(-3, 4)
"""Ticks around the likeliest delay, of which single rows tell the one with the least squared error."""

GROWING: Final = tuple(sign * ticks for ticks in (4, 6, 8, 11, 16, 23, 32, 45, 64) for sign in (-1.0, 1.0))
"""Delays at the end of a session that had none at its start, as where one of two clocks runs too fast."""

GROWING_S: Final = 60.0
"""In a shorter session, no clock goes wrong by a tick."""

FINER: Final = (0.75, 1.25)
"""A delay that grows, over the likeliest one."""

SMOOTHED_ROWS: Final = 11
"""0.1 s: a forest's prediction jumps from row to row, and only its slower changes follow the channel."""

SMOOTHED_TICKS: Final = 2
"""Over a longer delay the prediction changes by more than it jumps."""


_AT_THE_END: Final = "lag at the end"

_GROWING: Final = "growing"
"""How the form of a delay begins that grows."""


class Lag(Effect):
    """The channels show the model's prediction for an earlier or later time."""

    name = "lag"
    fits_nothing = True
    equation = "measured_c(t) = model_c(t - d), one d for all channels, or one that grows with t"
    source = "LASA: electrodes trail the force by 2 to 3 rows; clocks of two devices"
    signature = "the residual is the prediction's own change over time, the same delay in every channel"

    @override
    def forms(self, observations: Observations, remaining: Remaining) -> Iterable[Candidate]:
        smooth = _smoothed(observations)
        for ticks in TICKS:
            short = abs(ticks) <= SMOOTHED_TICKS
            yield self._late(ticks, smooth if short else observations.predicted, observations)
        if observations.time_s.max() > GROWING_S:
            for ticks in GROWING:
                yield self._growing(ticks, smooth, observations)

    @override
    def finer(
        self, observations: Observations, best: Candidate, fit: NDArray[np.bool_]
    ) -> Iterable[Candidate]:
        if _AT_THE_END in best.form_parameters:
            ticks, smooth = best.form_parameters[_AT_THE_END][0] / TICK_S, _smoothed(observations)
            for factor in FINER:
                yield self._growing(factor * ticks, smooth, observations)

    @override
    @classmethod
    def why_only_reported(cls, form: str) -> str:
        if form.startswith(_GROWING):
            return "no model knows when its session began; set the clocks right"
        least, most = 10 * min(SERVED), 10 * max(SERVED)
        return f"windows move by whole ticks of 10 ms, from {least} to {most} ms; set the clocks right"

    @override
    def by_rows(
        self, observations: Observations, best: Candidate, residual: Floats, fit: NDArray[np.bool_]
    ) -> Candidate:
        if "lag" not in best.form_parameters:
            return best
        ticks = best.form_parameters["lag"][0] / TICK_S
        predicted = observations.predicted

        def left(late: int) -> float:
            change = predicted[observations.rows_before(late)] - predicted
            squared = ((residual - change)[fit] ** 2).mean(axis=0)
            return float(np.log(np.maximum(squared, 1e-9)).sum())

        near = [round(ticks) + step for step in NEAR]
        logs = [left(late) for late in near]
        place = min(range(1, len(near) - 1), key=logs.__getitem__)
        before, least, after = logs[place - 1 : place + 2]
        # The lowest point of a parabola through the least and its neighbours.
        bend = before - 2.0 * least + after
        found = near[place] + (np.clip(0.5 * (before - after) / bend, -1, 1) if bend > 0 else 0.0)
        allowed = [each for each in (*TICKS, *range(-_LONGEST, _LONGEST + 1)) if each * ticks > 0]
        nearest = min(allowed, key=lambda each: abs(each - found))
        if nearest == ticks:
            return best
        whole = float(nearest).is_integer()
        return self._late(nearest, predicted if whole else _smoothed(observations), observations)

    def _late(self, ticks: float, counts: Floats, observations: Observations) -> Candidate:
        before, after = (counts[observations.rows_before(part)] for part in _around(ticks))
        change = 0.5 * (before + after) - counts
        served = ticks in SERVED
        return Candidate(
            self.name,
            f"{ticks * 10:g} ms",
            Own(change[:, :, None].astype(np.float32)),
            fitting=Fitting(fixed=True),
            form_parameters={"lag": (ticks * TICK_S, "s")},
            online=partial(_online, int(ticks)) if served else lambda _: Online(),
            moved=partial(_moved, int(ticks)) if served else None,
            again=None if served else lambda other: self._late(ticks, _smoothed(other), other),
        )

    def _growing(self, ticks: float, smooth: Floats, observations: Observations) -> Candidate:
        """A delay that is 0 at the session's start and so many ticks at its end.

        Args:
            smooth: (n, 21) the predictions without their jumps, counts.
        """
        share = observations.time_s / observations.time_s.max()
        before = observations.rows_before(np.rint(ticks * share).astype(np.int64))
        return Candidate(
            self.name,
            f"{_GROWING} from 0 to {ticks * 10:.0f} ms",
            Own((smooth[before] - smooth)[:, :, None].astype(np.float32)),
            fitting=Fitting(fixed=True),
            form_parameters={_AT_THE_END: (ticks * TICK_S, "s")},
            ages=True,
            again=lambda other: self._growing(ticks, _smoothed(other), other),
        )


def _around(ticks: float) -> tuple[int, int]:
    """The whole ticks on both sides."""
    return int(np.floor(ticks)), int(np.ceil(ticks))


def _smoothed(observations: Observations) -> Floats:
    """(n, 21) the predictions' mean over 0.1 s, within each segment."""
    return mean_within(observations.predicted, SMOOTHED_ROWS, runs(observations.segment))


def _online(ticks: int, weights: Floats) -> Online:
    del weights
    return Online(shift_ticks=ticks)


def _moved(ticks: int, observations: Observations) -> Observations:
    """The observations with windows of so many ticks earlier."""
    windows = observations.windows[observations.rows_before(ticks)]
    shift = observations.shift_ticks + ticks
    return observations.with_windows(windows, shift_ticks=shift)
