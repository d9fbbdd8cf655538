"""What is left before and after: its spectrum and its autocorrelation."""

from pathlib import Path
from typing import Final

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy import signal

from taxel.windows.history import TICK_S
from taxel_models.loop.basis import Floats
from taxel_models.loop.noise import NoiseFloor
from taxel_models.loop.observations import Observations
from taxel_models.loop.pipeline import LoopResult
from taxel_models.loop.report.colours import AFTER, BEFORE, NOISE
from taxel_models.loop.residual_diagnostics import autocorrelation

_LONGEST: Final = 1024
"""Rows of a piece: 10 s."""

_LAGS: Final = 18


def draw_residual(result: LoopResult, path: Path) -> str:
    """Draw both, each a mean over the channels.

    Returns:
        A caption.
    """
    observations, rows = result.observations, result.blocks.evaluation
    first = observations.measured - observations.predicted
    energy = np.maximum((first[rows] ** 2).mean(axis=0), 1e-9)
    stretches = _stretches(observations, rows)
    longest = max(stretch.stop - stretch.start for stretch in stretches)
    lags = np.unique(np.geomspace(1, max(2, min(_LONGEST, longest) // 2), _LAGS).astype(int))
    figure = Figure(figsize=(10, 3.8), layout="constrained")
    left, right = figure.subplots(1, 2)
    for residual, colour, label in (
        (first, BEFORE, "before"),
        (observations.measured - result.after, AFTER, "after"),
    ):
        frequencies, density = _density(residual, stretches)
        power = (density / energy).mean(axis=1)
        left.loglog(frequencies[1:-1], power[1:-1], color=colour, label=label)
        at_lags = [autocorrelation(observations, residual, rows, int(lag)) for lag in lags]
        right.semilogx(lags * TICK_S, at_lags, "o-", ms=3, color=colour, label=label)
    level = float((NoiseFloor.of(observations).differences ** 2 / energy).mean()) * 2 * TICK_S
    left.axhline(level, color=NOISE, ls="--", lw=1, label="the channels' noise")
    right.axhline(0, color="black", lw=0.7)
    left.set(xlabel="frequency, Hz", ylabel="power over the first residual's, 1/Hz", title="spectrum")
    right.set(xlabel="lag, s", title="autocorrelation")
    for axes in (left, right):
        axes.xaxis.set_major_formatter("{x:g}")
        axes.grid(alpha=0.3)
        axes.legend()
    figure.savefig(path, dpi=110, format="png")
    return (
        "Spectrum and autocorrelation of the residual on the evaluation part, mean over the channels. Were "
        "everything explained, the spectrum would lie on the noise and the autocorrelation at 0. A "
        "constant offset shows in neither."
    )


def _stretches(observations: Observations, rows: NDArray[np.bool_]) -> list[slice]:
    """Runs of the wanted rows inside segments."""
    starts = np.flatnonzero(np.diff(observations.segment * 2 + rows, prepend=-1))
    return [
        slice(int(start), int(stop))
        for start, stop in zip(starts, [*starts[1:], len(rows)], strict=True)
        if rows[start]
    ]


def _density(residual: Floats, stretches: list[slice]) -> tuple[Floats, Floats]:
    """Frequencies (m,), Hz, and one-sided power density (m, 21), counts²/Hz (Welch 1967)."""
    lengths = [stretch.stop - stretch.start for stretch in stretches]
    piece = min(_LONGEST, int(np.median(lengths)))
    densities = [
        signal.welch(residual[stretch], 1 / TICK_S, nperseg=piece, axis=0)[1]
        for stretch, length in zip(stretches, lengths, strict=True)
        if length >= piece
    ]
    frequencies: Floats = np.fft.rfftfreq(piece, TICK_S).astype(np.float64)
    return frequencies, np.asarray(np.mean(densities, axis=0))
