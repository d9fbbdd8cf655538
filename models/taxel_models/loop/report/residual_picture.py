"""The spectrum of the residual before and after."""

from typing import Final

import numpy as np
from matplotlib.figure import Figure

from taxel.windows.history import TICK_S
from taxel_models.loop.noise import NoiseFloor
from taxel_models.loop.pipeline import LoopResult
from taxel_models.loop.report.drawing import AFTER, BEFORE, NOISE, Drawing
from taxel_models.loop.spectrum import power_density, stretches

_LONGEST: Final = 1024
"""Rows of a piece: 10 s."""


def draw_spectrum(result: LoopResult) -> Drawing:
    """Draw the mean over the channels."""
    observations, rows = result.observations, result.blocks.evaluation
    first = observations.residual
    energy = np.maximum((first[rows] ** 2).mean(axis=0), 1e-9)
    wanted = stretches(observations, rows)
    piece = min(_LONGEST, int(np.median([stretch.stop - stretch.start for stretch in wanted])))
    figure = Figure(figsize=(9, 3.6), layout="constrained")
    axes = figure.subplots()
    for residual, colour, label in (
        (first, BEFORE, "before"),
        (result.left, AFTER, "after"),
    ):
        frequencies, density = power_density(residual, wanted, piece)
        power = (density / energy).mean(axis=1)
        axes.loglog(frequencies[1:-1], power[1:-1], color=colour, label=label)
    noise = NoiseFloor.of(observations, result.attribution.waves)
    level = float((noise.differences**2 / energy).mean()) * 2 * TICK_S
    axes.axhline(level, color=NOISE, ls="--", lw=1, label="the channels' noise")
    axes.set(xlabel="frequency, Hz", ylabel="power over the first residual's, 1/Hz")
    axes.xaxis.set_major_formatter("{x:g}")
    axes.grid(alpha=0.3)
    axes.legend()
    return figure, (
        "Spectrum of the residual on the evaluation part, mean over the channels, before and after what "
        "was found. Were everything explained, it would lie on the noise. A constant offset does not show."
    )
