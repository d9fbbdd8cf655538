"""The power spectrum of a residual that has gaps (Welch 1967)."""

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from taxel.windows.history import TICK_S
from taxel_models.loop.basis import Floats
from taxel_models.loop.observations import Observations, runs


def stretches(observations: Observations, rows: NDArray[np.bool_]) -> list[slice]:
    """Runs of the wanted rows inside segments, in order."""
    return [run for run in runs(observations.segment * 2 + rows) if rows[run.start]]


def power_density(residual: Floats, wanted: list[slice], piece: int) -> tuple[Floats, Floats]:
    """Mean over pieces of the stretches, half overlapping.

    Args:
        residual: (n, 21), counts.
        wanted: stretches of rows; those shorter than a piece are left out.
        piece: rows of a piece.

    Returns:
        Frequencies (m,), Hz, and one-sided power density (m, 21), counts²/Hz; both empty where no
        stretch is as long as a piece.
    """
    densities, pieces = [], []
    for stretch in wanted:
        rows = stretch.stop - stretch.start
        if rows >= piece:
            frequencies, density = signal.welch(residual[stretch], 1 / TICK_S, nperseg=piece, axis=0)
            densities.append(density)
            pieces.append(1 + (rows - piece) // (piece - piece // 2))
    if not densities:
        return np.empty(0), np.empty((0, residual.shape[1]))
    return np.asarray(frequencies), np.average(densities, axis=0, weights=pieces)
