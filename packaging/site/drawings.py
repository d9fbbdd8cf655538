"""The drawings of docs/concepts.md: `python packaging/site/drawings.py` writes them anew into `docs/`.

What they show comes from the code. The same code draws the same file.
"""

from pathlib import Path
from typing import Final

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import FancyArrowPatch, FancyBboxPatch

from taxel.windows import COMBINATIONS, PERIOD_NS, WindowSpec

DOCS: Final = Path(__file__).resolve().parents[2] / "docs"
DRAWINGS: Final = ("windows.svg", "loop.svg")

_FORCE, _PLACE, _QUIET = "#c0392b", "#2c6fbb", "#888888"
_TICK_MS: Final = PERIOD_NS / 1e6


def draw(folder: Path) -> None:
    """Write all drawings to a folder."""
    # No date, and names of parts that do not change: the same drawing is the same file.
    with mpl.rc_context({"svg.hashsalt": "taxel", "svg.fonttype": "none"}):
        for name, figure in zip(DRAWINGS, (_windows(), _loop()), strict=True):
            figure.savefig(folder / name, metadata={"Date": None})


def _windows() -> Figure:
    """A press, the ticks that a window takes from it, and the ticks of all eight combinations."""
    figure = Figure(figsize=(9.5, 6.2), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=[1.0, 1.7])
    time_ms = np.arange(-160, 161)
    force = 1.2 / (1.0 + np.exp(-time_ms / 30.0))
    above.plot(time_ms, force, color=_QUIET, linewidth=1)
    steps = np.array(WindowSpec.of(1).force_steps) * _TICK_MS
    above.plot(steps, np.interp(steps, time_ms, force), "o", color=_FORCE)
    above.set_ylabel("force, N")
    above.set_title(
        "A window of combination 1: three ticks of the force, and the place at time T", fontsize=10
    )
    for row, combination in enumerate(COMBINATIONS):
        spec = WindowSpec.of(combination)
        _row(below, row, spec)
    below.set_yticks(range(len(COMBINATIONS)), [f"combination {one}" for one in COMBINATIONS])
    below.set_ylim(len(COMBINATIONS) - 0.4, -0.9)
    below.set_xlabel("time around T, ms")
    below.set_xlim(-160, 215)
    above.plot([], [], "o", color=_FORCE, label="force (fx, fy, fz)")
    above.plot([], [], "s", color=_PLACE, label="place (x, y, z)")
    above.legend(loc="upper left", fontsize=8)
    for axes in (above, below):
        axes.axvline(0, color=_QUIET, linewidth=0.8, linestyle=":")
        axes.spines[["top", "right"]].set_visible(False)
    above.annotate("T", (0, 1.15), xytext=(4, 0), textcoords="offset points")
    return figure


def _row(axes: Axes, row: int, spec: WindowSpec) -> None:
    ticks = np.array(spec.force_steps) * _TICK_MS
    axes.plot(ticks, np.full(len(ticks), row), "o", color=_FORCE, markersize=4)
    places = {"now": 0.0, "last": -10 * _TICK_MS, "next": 10 * _TICK_MS}
    at = [places[one] for one in spec.positions]
    axes.plot(at, np.full(len(at), row - 0.35), "s", color=_PLACE, markersize=4)
    late = f"{spec.delay_s * 1e3:.0f} ms late" if spec.delay_s else "at once"
    axes.text(125, row, f"{len(spec.features)} numbers, {late}", va="center", fontsize=8)


def _loop() -> Figure:
    """The loop: from a recording and a model to a corrected version that serves."""
    figure = Figure(figsize=(9.5, 3.4), layout="constrained")
    axes = figure.subplots()
    axes.set_axis_off()
    axes.set_xlim(0, 100)
    axes.set_ylim(0, 34)
    boxes = {
        "recording": (2, 22, "recording of\nthe real sensor"),
        "model": (2, 4, "served model"),
        "residual": (27, 13, "residual:\nmeasured less\npredicted"),
        "effect": (52, 13, "named effects:\ncreep, gain, drift …\nand what is left"),
        "version": (77, 13, "corrected version,\nerror before\nand after"),
    }
    for x, y, text in boxes.values():
        axes.add_patch(
            FancyBboxPatch((x, y), 18, 8, boxstyle="round,pad=0.8", facecolor="#eef4fa", edgecolor=_PLACE)
        )
        axes.text(x + 9, y + 4, text, ha="center", va="center", fontsize=9)
    for start, end in (
        ((21.5, 26), (26, 19)),
        ((21.5, 8), (26, 15)),
        ((46, 17), (51, 17)),
        ((71, 17), (76, 17)),
    ):
        axes.add_patch(FancyArrowPatch(start, end, arrowstyle="-|>", mutation_scale=14, color=_QUIET))
    axes.add_patch(
        FancyArrowPatch(
            (86, 11.5),
            (21.5, 5),
            connectionstyle="arc3,rad=-0.12",
            arrowstyle="-|>",
            mutation_scale=14,
            color=_FORCE,
        )
    )
    axes.text(58, 8.6, "is served beside the old one", ha="center", fontsize=9, color=_FORCE)
    return figure


if __name__ == "__main__":
    draw(DOCS)
    print(f"Wrote {', '.join(DRAWINGS)} in {DOCS}.")
