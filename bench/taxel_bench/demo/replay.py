"""Replays a recording through a predictor, sample by sample, as a simulator's loop would."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from taxel.channels import CHANNELS
from taxel.predictor import Predictor
from taxel.windows import PERIOD_NS
from taxel_bench.timing import Latencies
from taxel_models.recordings import Recording

_PERIOD_S: Final = PERIOD_NS / 1e9


@dataclass(frozen=True)
class Replay:
    """What came of a replay.

    Attributes:
        measured: (n, 21) counts, at the windows' times.
        predicted: (n, 21) counts.
        latencies: of building the window and predicting it, one a window.
        seconds: from the first to the last answer.
    """

    measured: NDArray[np.float64]
    predicted: NDArray[np.float32]
    latencies: Latencies
    seconds: float

    @property
    def late(self) -> int:
        """Answers that took longer than the 10 ms between two samples."""
        return int((self.latencies.seconds > _PERIOD_S).sum())


def replay(
    recording: Recording,
    predictor: Predictor,
    *,
    paced: bool,
    watch: Callable[[int], None] = lambda _: None,
) -> Replay:
    """Push every sample of a recording of ticks into a live stream and predict each window.

    Args:
        paced: wait for each sample's time, as at 100 Hz; otherwise go flat out.
        watch: told how many samples are done.
    """
    stream = predictor.stream()
    row_of = {int(moment): row for row, moment in enumerate(recording.samples.time_ns)}
    rows: list[int] = []
    predicted: list[NDArray[np.float32]] = []
    seconds: list[float] = []
    samples = recording.samples
    began = time.perf_counter()
    for number, moment in enumerate(samples.time_ns.tolist()):
        if paced:
            time.sleep(max(0.0, began + number * _PERIOD_S - time.perf_counter()))
        start = time.perf_counter()
        for window in stream.push_ns(moment, samples.position[number], samples.force[number]):
            predicted.append(predictor.predict(window.values))
            seconds.append(time.perf_counter() - start)
            rows.append(row_of[window.time_ns])
        watch(number + 1)
    return Replay(
        recording.channels[rows],
        np.concatenate([np.empty((0, len(CHANNELS)), np.float32), *predicted]),
        Latencies(np.array(seconds)),
        time.perf_counter() - began,
    )
