"""Pictures of rounds: the confusion matrix, and the power by cause and strength."""

from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path
from typing import Final

import numpy as np
from matplotlib.figure import Figure

from taxel_models.recovery.rounds import NONE, POWER_EDGES, UNEXPLAINED, Rate, Summary, range_name

CONFUSION: Final = "confusion.png"
POWER: Final = "power.png"

_COLOUR: Final = "#30638e"
_COLUMNS: Final = 5


def write_pictures(summary: Summary, folder: Path) -> tuple[Path, ...]:
    """Write the pictures that there is anything to show in; returns their paths."""
    written = []
    if summary.confusion:
        written.append(folder / CONFUSION)
        draw_confusion(summary.confusion, written[-1])
    if summary.power:
        written.append(folder / POWER)
        draw_power(summary.power, written[-1])
    return tuple(written)


def draw_confusion(confusion: Mapping[str, Mapping[str, int]], path: Path) -> None:
    """Rows: what was injected. Columns: what was found first. Colours: shares of the row."""
    last = (UNEXPLAINED, NONE)
    found = sorted(
        {name for counts in confusion.values() for name in counts}, key=lambda one: (one in last, one)
    )
    counts = np.array([[own.get(name, 0) for name in found] for own in confusion.values()])
    shares = counts / counts.sum(axis=1, keepdims=True)
    figure = Figure(figsize=(2.5 + 0.5 * len(found), 2.0 + 0.27 * len(counts)), layout="constrained")
    axes = figure.subplots()
    axes.imshow(shares, cmap="Blues", vmin=0.0, vmax=1.0, aspect="auto")
    for row, column in np.argwhere(counts > 0):
        colour = "white" if shares[row, column] > 0.5 else "black"
        axes.text(column, row, str(counts[row, column]), ha="center", va="center", color=colour, fontsize=8)
    axes.set_xticks(range(len(found)), found, rotation=60, ha="right")
    axes.set_yticks(range(len(counts)), list(confusion))
    axes.set_xlabel("found first")
    axes.set_ylabel("injected")
    figure.savefig(path, dpi=110)


def draw_power(power: Mapping[str, Mapping[str, Rate]], path: Path) -> None:
    """For each cause, the share of rounds in which it was found first, with its 95 % interval."""
    rows = -(-len(power) // _COLUMNS)
    figure = Figure(figsize=(2.6 * _COLUMNS, 2.1 * rows), layout="constrained")
    grid = figure.subplots(rows, _COLUMNS, sharex=True, sharey=True, squeeze=False).ravel()
    middles = _middles()
    for axes, (truth, rates) in zip(grid, power.items(), strict=False):
        strength = [middles[name] for name in rates]
        share = np.array([one.share for one in rates.values()])
        low = share - np.array([one.low for one in rates.values()])
        high = np.array([one.high for one in rates.values()]) - share
        axes.errorbar(
            strength, share, [np.maximum(low, 0), np.maximum(high, 0)], fmt="o-", color=_COLOUR, ms=4
        )
        axes.set_title(f"{truth} ({sum(one.rounds for one in rates.values())})", fontsize=8)
        axes.set_xscale("log")
        axes.set_xticks([0.5, 1.0, 2.0], ["0.5", "1", "2"])
        axes.minorticks_off()
        axes.set_ylim(-0.05, 1.05)
        axes.grid(alpha=0.3)
    for axes in grid[len(power) :]:
        axes.set_visible(False)
    figure.supxlabel("strength over the residual")
    figure.supylabel("found first")
    figure.savefig(path, dpi=110)


def _middles() -> dict[str, float]:
    return {range_name(low, high): float(np.sqrt(low * high)) for low, high in pairwise(POWER_EDGES)}
