"""What is left before and after: its spectrum and its autocorrelation."""

from pathlib import Path
from typing import Final

import numpy as np
from matplotlib.figure import Figure

from taxel.windows.history import TICK_S
from taxel_models.loop.noise import NoiseFloor
from taxel_models.loop.pipeline import LoopResult
from taxel_models.loop.report.colours import AFTER, BEFORE, NOISE
from taxel_models.loop.residual_diagnostics import autocorrelation
from taxel_models.loop.spectrum import power_density, stretches

_LONGEST: Final = 1024
"""Rows of a piece: 10 s."""

_LAGS: Final = 18


def draw_residual(result: LoopResult, path: Path) -> str:
    """Draw both, each a mean over the channels.

    Returns:
        A caption.
    """
    observations, rows = result.observations, result.blocks.evaluation
    first = observations.residual
    energy = np.maximum((first[rows] ** 2).mean(axis=0), 1e-9)
    wanted = stretches(observations, rows)
    longest = max(stretch.stop - stretch.start for stretch in wanted)
    piece = min(_LONGEST, int(np.median([stretch.stop - stretch.start for stretch in wanted])))
    lags = np.unique(np.geomspace(1, max(2, min(_LONGEST, longest) // 2), _LAGS).astype(int))
    figure = Figure(figsize=(10, 3.8), layout="constrained")
    left, right = figure.subplots(1, 2)
    for residual, colour, label in (
        (first, BEFORE, "before"),
        (observations.measured - result.after, AFTER, "after"),
    ):
        frequencies, density = power_density(residual, wanted, piece)
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
