"""Correlations as pictures: of the residual with its past and with the inputs, and between parameters."""

from typing import Final

import numpy as np
from matplotlib.figure import Figure

from taxel.channels import CHANNELS
from taxel_models.loop.findings import Autocorrelation, CrossCorrelation, ParameterCorrelation
from taxel_models.loop.report.drawing import AFTER, BEFORE, NOISE, Drawing

_MOST_NAMED: Final = 40
"""More parameters get no names at the axes."""

_MOST_WRITTEN: Final = 12
"""So few parameters get their correlations as numbers."""

_COLUMNS: Final = 4


def draw_autocorrelation(found: Autocorrelation) -> Drawing:
    """The median channel, and where nine of ten channels lie."""
    figure = Figure(figsize=(9, 3.6), layout="constrained")
    axes = figure.subplots()
    for values, colour, label in ((found.before, BEFORE, "before"), (found.after, AFTER, "after")):
        table = np.array([values[name] for name in CHANNELS])
        low, middle, high = np.quantile(table, (0.05, 0.5, 0.95), axis=0)
        axes.semilogx(found.lags_s, middle, "o-", ms=3, color=colour, label=label)
        axes.fill_between(found.lags_s, low, high, color=colour, alpha=0.2, lw=0)
    band = np.array(found.band)
    axes.fill_between(found.lags_s, -band, band, color=NOISE, alpha=0.5, lw=0, label="99 % of white noise")
    axes.axhline(0, color="black", lw=0.7)
    axes.xaxis.set_major_formatter("{x:g}")
    axes.set(xlabel="lag, s", ylabel="autocorrelation")
    axes.grid(alpha=0.3)
    axes.legend()
    return figure, (
        "Autocorrelation of the residual on the evaluation part: the median channel, and where nine of ten "
        "channels lie. Were everything explained, it would lie in the grey band."
    )


def draw_cross_correlation(found: tuple[CrossCorrelation, ...]) -> Drawing:
    """A panel an input, each with the channel that depends on it most before."""
    rows = -(-len(found) // _COLUMNS)
    figure = Figure(figsize=(11, 0.6 + 2.3 * rows), layout="constrained")
    panels = figure.subplots(rows, _COLUMNS, squeeze=False, sharex=True, sharey=True).ravel()
    for panel, one in zip(panels, found, strict=False):
        channel, _, _ = strongest(one.before, one.band_before)
        panel.axhline(0, color="black", lw=0.7)
        for values, bands, colour, label in (
            (one.before, one.band_before, BEFORE, "before"),
            (one.after, one.band_after, AFTER, "after"),
        ):
            panel.plot(one.lags_s, values[channel], "o-", ms=3, color=colour, label=label)
            panel.axhspan(-bands[channel], bands[channel], color=colour, alpha=0.12, lw=0)
        panel.set_xscale("symlog", linthresh=0.01)
        panel.set_xticks([0.0, 0.01, 0.1, 1.0], ["0", "0.01", "0.1", "1"])
        panel.set_xlim(left=0.0)
        panel.set_title(f"{channel} with {one.input}", fontsize="medium")
        panel.grid(alpha=0.3)
    for panel in panels[len(found) :]:
        panel.set_visible(False)
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower right", ncols=2)
    figure.supxlabel("lag of the input, s", fontsize="medium")
    figure.supylabel("correlation", fontsize="medium")
    return figure, (
        "Correlation of the residual with each input so many seconds earlier, on the evaluation part, in "
        "the channel that depends on it most before. A residual that does not depend on the input stays in "
        "the band of its colour (99 %, by the scatter between blocks)."
    )


def strongest(values: dict[str, tuple[float, ...]], bands: dict[str, float]) -> tuple[str, int, float]:
    """The channel and the lag's place where a correlation is largest over its band, and its value."""
    table = np.array([values[name] for name in CHANNELS])
    over = np.abs(table) / np.maximum([bands[name] for name in CHANNELS], 1e-9)[:, None]
    channel, lag = divmod(int(over.argmax()), table.shape[1])
    return CHANNELS[channel], lag, float(table[channel, lag])


def outside(values: dict[str, tuple[float, ...]], bands: dict[str, float]) -> list[str]:
    """Channels whose correlation leaves its band at some lag."""
    return [name for name in CHANNELS if max(map(abs, values[name])) > bands[name]]


def draw_parameter_correlation(found: ParameterCorrelation) -> Drawing:
    """The matrix as colours."""
    matrix, count = np.array(found.matrix), len(found.parameters)
    side = min(9.0, 2.6 + 0.32 * count)
    figure = Figure(figsize=(side + 3.5, side + 2.0), layout="constrained")
    axes = figure.subplots()
    drawn = axes.imshow(matrix, vmin=-1, vmax=1, cmap="RdBu_r")
    if count <= _MOST_NAMED:
        axes.set_xticks(range(count), found.parameters, rotation=90, fontsize="small")
        axes.set_yticks(range(count), found.parameters, fontsize="small")
    else:
        axes.set_xticks([])
        axes.set_yticks([])
    if count <= _MOST_WRITTEN:
        for row, column in np.ndindex(matrix.shape):
            value = matrix[row, column]
            colour = "white" if abs(value) > 0.6 else "black"
            axes.text(column, row, f"{value:.2f}", ha="center", va="center", color=colour, fontsize="small")
    figure.colorbar(drawn, ax=axes, shrink=0.8, label="correlation")
    return figure, (
        "Correlation of each two weights of the named effects, in the channel where it is largest. Near 1 "
        "or -1, the recording tells only a difference or a sum of the two. Time constants and turned "
        "inputs are not among them."
    )
