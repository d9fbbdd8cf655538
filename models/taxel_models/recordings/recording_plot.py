"""A picture of a recording over time: contact, pressure, vibration and electrodes."""

from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from taxel.atomic import whole_file
from taxel.channels import CHANNELS, ELECTRODE_COLUMNS, ELECTRODES
from taxel.errors import SettingsError
from taxel_models.recordings.recording import Recording

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SUFFIXES: Final = (".png", ".pdf", ".svg")

_BINS: Final = 1400
"""Columns of the picture. For a longer recording, each shows mean and range of its rows."""

_MARKED_SEGMENTS: Final = 60
"""If there are more segments, they are not marked: the marks would hide the curves."""


def draw(recording: Recording, path: Path) -> None:
    """Draw a recording of at least one row to a PNG, PDF or SVG file, which appears whole or not at all.

    Raises:
        SettingsError: the file's suffix is none of `SUFFIXES`, or it cannot be written.
    """
    if path.suffix.lower() not in SUFFIXES:
        raise SettingsError(
            f"{path}: cannot draw a {path.suffix or 'file without suffix'}; expected .png, .pdf or .svg"
        )
    figure = _figure(recording)
    try:
        with whole_file(path) as temporary:
            figure.savefig(temporary, format=path.suffix[1:].lower(), dpi=130)
    except OSError as error:
        raise SettingsError(f"{path}: cannot be written: {error.strerror}") from None


def _figure(recording: Recording) -> "Figure":
    from matplotlib.figure import Figure

    samples = recording.samples
    starts = _bin_starts(len(recording))
    time = _elapsed_s(recording)
    figure = Figure(figsize=(13, 10), layout="constrained")
    axes = figure.subplots(5, 1, sharex=True, height_ratios=[1, 1, 1, 1, 2.2])
    centred = (samples.position - np.median(samples.position, axis=0)) * 1e3
    curves = [
        ("position less\nmedian, mm", dict(zip("xyz", centred.T, strict=True))),
        ("force, N", {"|f|": np.linalg.norm(samples.force, axis=1)}),
        *(
            (f"{name}, counts", {name: recording.channels[:, CHANNELS.index(name)]})
            for name in ("pdc", "pac0")
        ),
    ]
    for axis, (label, columns) in zip(axes, curves, strict=False):
        for name, values in columns.items():
            _curve(axis, name, time, values, starts)
        axis.set_ylabel(label)
        axis.grid(alpha=0.3)
        axis.margins(x=0)
    axes[0].legend(loc="upper right", ncols=3)
    _heat_map(figure, axes[-1], recording, time, starts)
    if len(recording.segments) <= _MARKED_SEGMENTS:
        for axis in axes:
            for segment in recording.segments[1:]:
                axis.axvline(time[segment.start], color="0.35", linewidth=0.6, linestyle=":")
    axes[-1].set_xlabel("time without the gaps between segments, s")
    axes[0].set_title(f"{recording.name}: rows {len(recording):,}, segments {len(recording.segments)}")
    return figure


def _bin_starts(rows: int) -> NDArray[np.int64]:
    """First row of each of at most `_BINS` bins of nearly equal size."""
    bins = min(rows, _BINS)
    return np.arange(bins, dtype=np.int64) * rows // bins


def _elapsed_s(recording: Recording) -> NDArray[np.float64]:
    """Seconds since the first row with every gap between segments cut to one period, (n,)."""
    samples = recording.samples
    intervals = np.diff(samples.time_ns, prepend=samples.time_ns[:1])
    intervals[[segment.start for segment in recording.segments[1:]]] = samples.period_ns
    return np.cumsum(intervals) / 1e9


def _means(values: NDArray[np.float64], starts: NDArray[np.int64]) -> NDArray[np.float64]:
    sizes = np.diff(starts, append=len(values))
    sums: NDArray[np.float64] = np.add.reduceat(values, starts, axis=0)
    return sums / sizes.reshape(-1, *[1] * (values.ndim - 1))


def _curve(
    axis: "Axes",
    name: str,
    time: NDArray[np.float64],
    values: NDArray[np.float64],
    starts: NDArray[np.int64],
) -> None:
    centres = _means(time, starts)
    (line,) = axis.plot(centres, _means(values, starts), linewidth=0.9, label=name)
    if len(starts) < len(values):
        low, high = np.minimum.reduceat(values, starts), np.maximum.reduceat(values, starts)
        axis.fill_between(centres, low, high, color=line.get_color(), alpha=0.25, linewidth=0)


def _heat_map(
    figure: "Figure",
    axis: "Axes",
    recording: Recording,
    time: NDArray[np.float64],
    starts: NDArray[np.int64],
) -> None:
    electrodes = recording.channels[:, ELECTRODE_COLUMNS]
    change = _means(electrodes - np.median(electrodes, axis=0), starts)
    limit = max(float(np.quantile(np.abs(change), 0.995)), 1.0)
    edges = np.append(time[starts], time[-1] + recording.samples.period_ns / 1e9)
    rows = np.arange(len(ELECTRODES) + 1) + 0.5
    image = axis.pcolormesh(edges, rows, change.T, cmap="RdBu_r", vmin=-limit, vmax=limit, rasterized=True)
    axis.set_yticks(range(1, len(ELECTRODES) + 1), ELECTRODES, fontsize=7)
    axis.invert_yaxis()
    figure.colorbar(image, ax=axis, label="electrode less its median, counts", extend="both", pad=0.01)
