"""The session as pictures: contacts as traces, and the residual of each channel over time."""

from typing import Final

import numpy as np
from matplotlib.figure import Figure

from taxel.channels import CHANNELS
from taxel.windows.history import TICK_S
from taxel_models.loop.basis import Floats
from taxel_models.loop.pipeline import LoopResult
from taxel_models.loop.report.drawing import AFTER, BEFORE, MEASURED, Drawing

_CHANNELS_SHOWN: Final = 3
_MOST_RECORDINGS_MARKED: Final = 20


def draw_traces(result: LoopResult) -> Drawing:
    """Measured, predicted and corrected counts of a typical and of the worst held-out block."""
    observations = result.observations
    scale = np.array(observations.manifest.normalisation.output_std)
    before = np.abs(observations.residual) / scale
    after = np.abs(observations.measured - result.after) / scale
    figure = Figure(figsize=(11, 0.8 + 1.9 * _CHANNELS_SHOWN), layout="constrained")
    panels = figure.subplots(_CHANNELS_SHOWN, 2, squeeze=False)
    for column, (label, rows) in zip(panels.T, _blocks(result, after), strict=True):
        error, corrected = before[rows].mean(), after[rows].mean()
        start = observations.time_s[rows[0]]
        errors = f"{error:.3f} before, {corrected:.3f} after" if result.new.effects else f"{error:.3f}"
        title = f"{label} block, from {start:.0f} s on\nnormalised MAE {errors}"
        column[0].set_title(title, fontsize="medium")
        shown = np.sort(np.argsort(-before[rows].mean(axis=0))[:_CHANNELS_SHOWN])
        seconds = TICK_S * np.arange(len(rows))
        for panel, channel in zip(column, shown, strict=True):
            panel.plot(
                seconds, observations.measured[rows, channel], color=MEASURED, lw=1.6, label="measured"
            )
            panel.plot(
                seconds, observations.predicted[rows, channel], color=BEFORE, lw=1.2, label="predicted"
            )
            if result.new.effects:
                panel.plot(seconds, result.after[rows, channel], color=AFTER, lw=1.2, label="corrected")
            panel.set_ylabel(f"{CHANNELS[channel]}, counts")
            panel.grid(alpha=0.3)
        column[-1].set_xlabel("s")
    figure.legend(*panels[0, 0].get_legend_handles_labels(), loc="outside upper right", ncols=3)
    return figure, (
        "Measured, predicted and corrected counts of the typical held-out block (the median error after) "
        "and of the worst, in the three channels that are furthest off before."
    )


def _blocks(result: LoopResult, after: Floats) -> list[tuple[str, np.ndarray]]:
    """Rows of the block with the median error and of that with the largest."""
    blocks = result.blocks
    numbers = np.unique(blocks.of_row[blocks.evaluation])
    rows = [np.flatnonzero(blocks.of_row == number) for number in numbers]
    order = np.argsort([after[some].mean() for some in rows])
    return [("typical", rows[order[len(order) // 2]]), ("worst", rows[order[-1]])]


def draw_session(result: LoopResult) -> Drawing:
    """The size of each channel's residual in each block, before and, if anything is corrected, after."""
    observations, blocks = result.observations, result.blocks
    scale = np.array(observations.manifest.normalisation.output_std)
    numbers = np.unique(blocks.of_row[blocks.of_row >= 0])
    rows = [np.flatnonzero(blocks.of_row == number) for number in numbers]
    residuals = {"before": observations.residual}
    if result.new.effects:
        residuals["after"] = observations.measured - result.after
    sizes = [
        np.array([np.sqrt(((residual[some] / scale) ** 2).mean(axis=0)) for some in rows]).T
        for residual in residuals.values()
    ]
    most = float(np.quantile(sizes[0], 0.98))
    figure = Figure(figsize=(11, 0.6 + 3.0 * len(sizes)), layout="constrained")
    panels = figure.subplots(len(sizes), 1, sharex=True, squeeze=False)[:, 0]
    for panel, size, label in zip(panels, sizes, residuals, strict=True):
        drawn = panel.imshow(
            size, aspect="auto", vmin=0, vmax=most, cmap="magma_r", interpolation="nearest"
        )
        panel.set_yticks(range(len(CHANNELS)), CHANNELS, fontsize="x-small")
        panel.set_title(label, fontsize="medium")
    starts = np.cumsum([len(some) for some in observations.rows])[:-1]
    if len(starts) < _MOST_RECORDINGS_MARKED:
        for start in starts:
            place = int(np.searchsorted([some[0] for some in rows], start))
            for panel in panels:
                panel.axvline(place - 0.5, color="black", lw=1)
    ticks = np.unique(np.linspace(0, len(rows) - 1, 9).astype(int))
    panels[-1].set_xticks(ticks, [f"{observations.time_s[rows[tick][0]]:.0f}" for tick in ticks])
    panels[-1].set_xlabel("the block's time in its recording, s")
    figure.colorbar(drawn, ax=list(panels), label="RMS of the residual / SD")
    return figure, (
        "The size of each channel's residual over the session, block by block, with those that were fitted "
        "to. A channel that fails or ages is a row that turns dark; a disturbed moment is a dark column. A "
        "line stands between recordings."
    )
