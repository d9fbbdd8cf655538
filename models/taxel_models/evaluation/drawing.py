"""Predictions against measurements as pictures."""

from pathlib import Path
from typing import Final

import matplotlib as mpl
import numpy as np
from numpy.typing import NDArray

from taxel.channels import CHANNELS
from taxel_models.evaluation.metrics import Errors

mpl.use("Agg")

from matplotlib import pyplot as plt

_SHOWN: Final = ("pac0", "pdc", "e1", "e4", "e7", "e9", "e11", "e17")
_SHOWN_SECONDS: Final = 20.0
_MEASURED, _PREDICTED = "#444444", "#d1495b"


def draw_errors(errors: Errors, title: str, path: Path) -> None:
    """A bar a channel: the normalised MAE, with the average over all as a line."""
    figure, axes = plt.subplots(figsize=(9, 3.6), layout="constrained")
    axes.bar(CHANNELS, errors.channel_norm_mae, color="#30638e")
    axes.axhline(errors.norm_mae, color=_PREDICTED, label=f"all 21 channels: {errors.norm_mae:.3f}")
    axes.set_ylabel("normalised MAE")
    axes.set_title(title)
    axes.legend()
    axes.grid(axis="y", alpha=0.3)
    figure.savefig(path, dpi=120)
    plt.close(figure)


def draw_traces(
    time_ns: NDArray[np.int64],
    measured: NDArray[np.float64],
    predicted: NDArray[np.float32],
    title: str,
    path: Path,
) -> None:
    """Some channels over the first 20 s of windows, measured and predicted; gaps are closed."""
    steps = np.minimum(np.diff(time_ns, prepend=time_ns[0]), 50_000_000)
    seconds = np.cumsum(steps) / 1e9
    shown = seconds <= _SHOWN_SECONDS
    figure, grid = plt.subplots(len(_SHOWN), 1, figsize=(10, 11), sharex=True, layout="constrained")
    for axes, name in zip(grid, _SHOWN, strict=True):
        column = CHANNELS.index(name)
        axes.plot(seconds[shown], measured[shown, column], color=_MEASURED, lw=1.0, label="measured")
        axes.plot(seconds[shown], predicted[shown, column], color=_PREDICTED, lw=0.9, label="predicted")
        axes.set_ylabel(f"{name}, counts")
        axes.grid(alpha=0.3)
    grid[0].legend(loc="upper right", ncols=2)
    grid[0].set_title(title)
    grid[-1].set_xlabel("seconds of windows, gaps closed")
    figure.savefig(path, dpi=110)
    plt.close(figure)
