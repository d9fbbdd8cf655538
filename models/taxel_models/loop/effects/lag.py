"""Lag: channels and inputs are misaligned in time."""

from collections.abc import Iterable
from dataclasses import replace
from functools import partial
from typing import Final

import numpy as np
from typing_extensions import override

from taxel.windows.history import TICK_S
from taxel_models.loop.basis import Own
from taxel_models.loop.effects.effect import Candidate, Effect, Left
from taxel_models.loop.evidence import Evidence
from taxel_models.loop.moments import Fitting
from taxel_models.loop.planting import Planting
from taxel_models.recordings import Recording

TICKS: Final = (*range(-5, 0), *range(1, 16))


class Lag(Effect):
    """The channels show what the model predicts for an earlier, or later, moment."""

    name = "lag"
    equation = "measured_c(t) = model_c(t - d), one d for all channels"
    source = "LASA: electrodes trail the force by 2 to 3 rows; clocks of two devices"
    signature = "the residual is the prediction's own change over time, the same delay in every channel"

    @override
    def forms(self, evidence: Evidence, left: Left) -> Iterable[Candidate]:
        for ticks in TICKS:
            earlier = evidence.rows_before(ticks)
            change = evidence.predicted[earlier] - evidence.predicted
            yield Candidate(
                self.name,
                f"{ticks * 10} ms",
                Own(change[:, :, None].astype(np.float32)),
                fitting=Fitting(fixed=True),
                settled={"lag": (ticks * TICK_S, "s")},
                moved=partial(_moved, ticks),
            )

    @override
    def plant(self, planting: Planting) -> None:
        recording = planting.recording
        rows, first = np.arange(len(recording)), np.zeros(len(recording), np.int64)
        for segment in recording.segments:
            first[segment] = segment.start

        def trailing(ticks: int) -> Recording:
            return replace(recording, channels=recording.channels[np.maximum(rows - ticks, first)])

        ticks = range(1, TICKS[-1] + 1)
        planting.search(((one * TICK_S, partial(trailing, one)) for one in ticks), "lag", "s")


def _moved(ticks: int, evidence: Evidence) -> Evidence:
    """The evidence with windows from so many ticks before."""
    windows = evidence.windows[evidence.rows_before(ticks)]
    shift = evidence.shift_ticks + ticks
    return evidence.with_windows(windows, turn=evidence.turn, shift_ticks=shift)
