"""Error, delay, warm-up and latency of all models of a repository."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import reduce
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

import taxel
from taxel.errors import SettingsError
from taxel.predictor import Predictor
from taxel.windows import build_windows
from taxel_bench.timing import interleaved, warm_up
from taxel_models.evaluation.metrics import ErrorMetrics
from taxel_models.model import predict_all
from taxel_models.recordings import Recording
from taxel_models.twin import simulate

_TWIN_SEED: Final = 1000
"""Twins of the shipped models' training and of tests have other seeds."""

_TWIN_ROWS: Final = 60_000
_COLD_ROWS: Final = 60_000
"""A finger warms up in its first minutes, which are few among those of a long training."""

_WARM_UP_ROUNDS: Final = 200
_WARM_UP_S: Final = 20.0


@dataclass(frozen=True)
class ComparedModel:
    """One model on the recording.

    Attributes:
        delay_ms: how long after its moment a live answer comes; 0 if causal.
        warm_up_ms: from a stream's first sample to its first answer.
        median_us: latency of one window in this process.
        cpu_median_us: the processor's time for it; other programs do not change it much.
        parameters: numbers that training found.
    """

    model: str
    combination: int
    delay_ms: float
    warm_up_ms: float
    mae: float
    norm_mae: float
    median_us: float
    cpu_median_us: float
    parameters: int


def unseen_twin(seed: int) -> Recording:
    """A recording of the twin that no shipped model was trained on."""
    recording = simulate(_COLD_ROWS + _TWIN_ROWS, _TWIN_SEED + seed)
    return recording.rows(slice(_COLD_ROWS, None))


def compare_models(
    repository: Path, recording: Recording, repetitions: int, seed: int
) -> list[ComparedModel]:
    """The newest version of each model that can be loaded, at moments for which all have windows.

    Raises:
        SettingsError: there is no model, or the recording has no window.
    """
    with taxel.load(repository) as source:
        names = sorted({model.name for model in source.models() if model.state == "READY"})
        if not names:
            raise SettingsError(f"{repository}: no model can be loaded; expected at least one")
        predictors = [source.predictor(name) for name in names]
        ticks = recording.ticks()
        given = {**ticks.auxiliary, **ticks.covariates}
        windows = [
            build_windows(ticks.samples, predictor.window, predictor.manifest.window.extras, given)
            for predictor in predictors
        ]
        rows = reduce(np.intersect1d, [found.rows for found in windows])
        if not len(rows):
            raise SettingsError(f"{recording.name}: no moment has a window of every model")
        inputs = [found.values[np.isin(found.rows, rows)] for found in windows]
        errors = [
            ErrorMetrics.of(
                ticks.channels[rows],
                predict_all(each.predict, values),
                each.manifest.normalisation.output_std,
            )
            for each, values in zip(predictors, inputs, strict=True)
        ]
        calls = [_one_window(each, values) for each, values in zip(predictors, inputs, strict=True)]
        warm_up(calls, rounds=_WARM_UP_ROUNDS, seconds=_WARM_UP_S)
        timed = interleaved(calls, repetitions=repetitions, seed=seed)
        return [
            ComparedModel(
                model=each.manifest.label,
                combination=each.window.combination,
                delay_ms=each.window.delay_s * 1e3,
                warm_up_ms=each.window.warm_up_s * 1e3,
                mae=error.mae,
                norm_mae=error.norm_mae,
                median_us=times.median_ms * 1e3,
                cpu_median_us=times.cpu_median_ms * 1e3,
                parameters=each.manifest.parameters,
            )
            for each, error, times in zip(predictors, errors, timed, strict=True)
        ]


def _one_window(predictor: Predictor, windows: NDArray[np.float32]) -> Callable[[int], object]:
    """Predicts another window of the recording at each call."""
    return lambda number: predictor.predict(windows[number % len(windows)][None])
