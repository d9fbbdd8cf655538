"""Predicts recordings for a replay, in a process of its own.

A model that is compiled in the page's process would make the page stutter for half a minute.
"""

import multiprocessing
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from taxel.channels import CHANNELS
from taxel.commands.models import open_source
from taxel.predictor import Predictor
from taxel.windows import build_windows
from taxel_models.model import predict_all
from taxel_models.recordings import Recording
from taxel_watch.replay import Predictions, Replay
from taxel_watch.scene import CORRECTED, PREDICTED

_TIMED: Final = 200
"""Single windows that are timed."""


@dataclass(frozen=True)
class Asked:
    """What is to predict, as on the command line.

    Attributes:
        model: NAME or NAME/VERSION.
        corrected: the same, of a model to show beside it; None if none.
        connect: the server that is asked; None for this process.
        repository: the models' folder; None for those that come with Taxel.
    """

    model: str
    corrected: str | None = None
    connect: str | None = None
    repository: Path | None = None


class Predicting:
    """Predicts in the background from construction until `close`, and tells the replay.

    Args:
        replay: is told the predictions, or why there are none.
        asked: what is to predict.
    """

    def __init__(self, replay: Replay, asked: Asked) -> None:
        self._replay = replay
        replay.predicted(
            Predictions(note=f"{asked.model} is loading; the first time, it compiles for a while")
        )
        self._pool = multiprocessing.get_context("spawn").Pool(1)
        self._result = self._pool.apply_async(
            predict, (replay.recordings, asked), callback=replay.predicted, error_callback=self._say_why_not
        )

    def _say_why_not(self, error: BaseException) -> None:
        self._replay.predicted(Predictions(note=f"no prediction: {error}"))

    def wait(self) -> None:
        """Return when all is predicted.

        Raises:
            TaxelError: a model cannot be had.
        """
        self._replay.predicted(self._result.get())

    def close(self) -> None:
        """Stop, finished or not."""
        self._pool.terminate()


def predict(recordings: Sequence[Recording], asked: Asked) -> Predictions:
    """Predict every row of recordings.

    A corrected model of this process gives its base, too: that is then `predicted`.

    Raises:
        TaxelError: a model cannot be had.
    """
    with open_source(asked.connect, asked.repository) as source:
        predictor = source.predictor(*_parts(asked.model))
        ways = [_Way(PREDICTED, predictor, predictor.predict)]
        if asked.corrected:
            other = source.predictor(*_parts(asked.corrected))
            ways.append(_Way(CORRECTED, other, other.predict))
        elif predictor.manifest.effects and asked.connect is None:
            ways = [
                _Way(PREDICTED, predictor, predictor.predict_base, " without its effects"),
                _Way(CORRECTED, predictor, predictor.predict),
            ]
        return Predictions(
            models={way.trace: way.label for way in ways},
            counts=[{way.trace: way.counts(recording) for way in ways} for recording in recordings],
            window_us=_timed(predictor),
            where=asked.connect or "in process",
        )


class _Way(NamedTuple):
    """What gives one trace."""

    trace: str
    predictor: Predictor
    predict: Callable[[NDArray[np.float32]], NDArray[np.float32]]
    what: str = ""

    @property
    def label(self) -> str:
        return f"{self.predictor.manifest.label}{self.what}"

    def counts(self, recording: Recording) -> NDArray[np.float64]:
        """(n, 21) counts, NaN where a window would reach beyond its segment."""
        given = {**recording.auxiliary, **recording.covariates}
        extras = self.predictor.manifest.window.extras
        windows = build_windows(recording.samples, self.predictor.window, extras, given)
        counts = np.full((len(recording), len(CHANNELS)), np.nan)
        if len(windows):
            counts[windows.rows] = predict_all(self.predict, windows.values)
        return counts


def _parts(model: str) -> tuple[str, str | None]:
    name, _, version = model.partition("/")
    return name, version or None


def _timed(predictor: Predictor) -> dict[str, float]:
    """How long a single window takes, µs."""
    window = np.asarray([predictor.manifest.typical_window], np.float32)
    times = np.empty(_TIMED)
    for number in range(_TIMED):
        began = time.perf_counter()
        predictor.predict(window)
        times[number] = time.perf_counter() - began
    return {"p50": float(1e6 * np.median(times)), "p99": float(1e6 * np.quantile(times, 0.99))}
