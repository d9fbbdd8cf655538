"""Lag: channels and inputs are misaligned in time."""

from collections.abc import Iterable
from functools import partial
from typing import Final

import numpy as np
from typing_extensions import override

from taxel.windows.history import TICK_S
from taxel_models.loop.basis import Floats, Own
from taxel_models.loop.effects.effect import Candidate, Effect, Fitting, Online, Remaining
from taxel_models.loop.observations import Observations

TICKS: Final = (*range(-5, 0), *range(1, 16))


class Lag(Effect):
    """The channels show the model's prediction for an earlier or later time."""

    name = "lag"
    equation = "measured_c(t) = model_c(t - d), one d for all channels"
    source = "LASA: electrodes trail the force by 2 to 3 rows; clocks of two devices"
    signature = "the residual is the prediction's own change over time, the same delay in every channel"

    @override
    def forms(self, observations: Observations, remaining: Remaining) -> Iterable[Candidate]:
        for ticks in TICKS:
            earlier = observations.rows_before(ticks)
            change = observations.predicted[earlier] - observations.predicted
            yield Candidate(
                self.name,
                f"{ticks * 10} ms",
                Own(change[:, :, None].astype(np.float32)),
                fitting=Fitting(fixed=True),
                form_parameters={"lag": (ticks * TICK_S, "s")},
                online=partial(_online, ticks),
                moved=partial(_moved, ticks),
            )


def _online(ticks: int, weights: Floats) -> Online:
    del weights
    return Online(shift_ticks=ticks)


def _moved(ticks: int, observations: Observations) -> Observations:
    """The observations with windows of so many ticks earlier."""
    windows = observations.windows[observations.rows_before(ticks)]
    shift = observations.shift_ticks + ticks
    return observations.with_windows(windows, turn=observations.turn, shift_ticks=shift)
