"""Residual diagnostics: whether the remaining residual is noise, or structure that no effect explains."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from taxel.channels import CHANNELS
from taxel.windows.history import TOUCH_N
from taxel_models.loop.basis import Floats
from taxel_models.loop.findings import Unexplained
from taxel_models.loop.noise import NoiseFloor
from taxel_models.loop.observations import Observations
from taxel_models.loop.residual_correlation import correlations
from taxel_models.loop.spectrum import power_density, stretches

MORE_THAN_NOISE: Final = 0.1
"""The residual counts as structured if noise leaves at least this share of its energy unexplained."""

AUTOCORRELATION: Final = 0.1

IN_A_CHANNEL: Final = 0.3
"""The same for one channel's share and autocorrelation: the mean hides an effect of few channels."""

_SECOND: Final = 100
PIECE_ROWS: Final = 256
"""Of the spectrum: 2.56 s."""

_PEAK: Final = 8.0
"""The least power of a spectral line that is reported, over the median of a band around it."""


def diagnose_residual(
    observations: Observations, left: Floats, noise: NoiseFloor, rows: NDArray[np.bool_]
) -> Unexplained:
    """Judge what is left at some rows.

    Args:
        left: (n, 21) measured less corrected, counts.
        noise: of each channel.
    """
    energy = (left[rows] ** 2).mean(axis=0)
    shares = 1.0 - noise.share(energy)
    tick = correlations(observations, left, rows, 1)
    share = float(shares.mean())
    lags = {"10 ms": float(tick.mean()), "1 s": autocorrelation(observations, left, rows, _SECOND)}
    structured = share > MORE_THAN_NOISE and lags["10 ms"] > AUTOCORRELATION
    structured |= bool((np.minimum(shares, tick) > IN_A_CHANNEL).any())
    hint = "indistinguishable from the channels' noise"
    if structured:
        hint = _hint(observations, left, rows, energy * shares)
    return Unexplained(structured=structured, hint=hint, share=share, autocorrelation=lags)


def autocorrelation(observations: Observations, left: Floats, rows: NDArray[np.bool_], lag: int) -> float:
    """Mean over the channels at a lag in ticks, inside segments."""
    return float(correlations(observations, left, rows, lag).mean())


def _hint(observations: Observations, left: Floats, rows: NDArray[np.bool_], beyond: Floats) -> str:
    """A sentence on where to look. `beyond` (21,) is each channel's energy beyond noise, counts²."""
    relative = beyond / np.maximum(observations.measured[rows].var(axis=0), 1e-9)
    worst = [CHANNELS[channel] for channel in np.argsort(-relative)[:3]]
    hints = [f"most in {', '.join(worst)}"]
    line = _line(observations, left)
    if line is not None:
        hints.append(f"periodic at {line:.2f} Hz")
    free = rows & (observations.pressed < TOUCH_N)
    if free.sum() > _SECOND:
        quiet, all_rows = (left[free] ** 2).mean(), (left[rows] ** 2).mean()
        hints.append(
            "as large in free air" if quiet > 0.5 * all_rows else "while touched rather than in free air"
        )
    return "; ".join(hints)


def _line(observations: Observations, left: Floats) -> float | None:
    """The frequency of a strong spectral line, Hz. All rows are used, since a hum is in each of them."""
    wanted = stretches(observations, np.ones(len(left), bool))
    frequencies, power = power_density(left, wanted, PIECE_ROWS)
    if not len(power):
        return None
    total = (power / np.maximum(power.sum(axis=0), 1e-9)).mean(axis=1)
    around = np.array([np.median(total[max(1, k - 8) : k + 9]) for k in range(len(total))])
    ratio = np.where(np.arange(len(total)) >= 3, total / np.maximum(around, 1e-18), 0.0)
    best = int(np.argmax(ratio))
    return float(frequencies[best]) if ratio[best] > _PEAK else None
