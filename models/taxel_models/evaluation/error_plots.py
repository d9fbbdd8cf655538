"""Predictions against measurements as pictures."""

from pathlib import Path
from typing import Final

import matplotlib as mpl
import numpy as np
from numpy.typing import NDArray

from taxel.channels import CHANNELS
from taxel_models.evaluation.metrics import ErrorMetrics

mpl.use("Agg")

from matplotlib import pyplot as plt

_SHOWN: Final = ("pac0", "pdc", "e1", "e4", "e7", "e9", "e11", "e17")
_SHOWN_SECONDS: Final = 20.0
_MEASURED, _PREDICTED = "#444444", "#d1495b"


def draw_errors(errors: ErrorMetrics, by_stretch: NDArray[np.float64], title: str, path: Path) -> None:
    """Draw one box for each channel: its normalised MAE over stretches, with its mean as a dot.

    Args:
        errors: over everything.
        by_stretch: (stretches, 21) normalised MAE of each trial or chunk.
        title: title of the picture.
        path: the picture to write.
    """
    figure, axes = plt.subplots(figsize=(9, 3.8), layout="constrained")
    axes.boxplot(by_stretch, tick_labels=CHANNELS, showfliers=False, medianprops={"color": "#30638e"})
    places = range(1, len(CHANNELS) + 1)
    axes.plot(places, errors.channel_norm_mae, "o", ms=4, color=_PREDICTED, label="over all windows")
    axes.axhline(errors.norm_mae, color=_PREDICTED, lw=0.8, label=f"all 21 channels: {errors.norm_mae:.3f}")
    axes.set_ylabel("normalised MAE")
    axes.set_ylim(bottom=0)
    axes.set_title(f"{title}: {len(by_stretch)} stretches")
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
