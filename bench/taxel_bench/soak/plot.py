"""The plot of `bench soak`: memory, files, threads and p99 over time."""

from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")

import numpy as np
from matplotlib import pyplot as plt

from taxel_bench.soak.measurement import POINTS, Soak, p99_by_interval

_PANELS = (
    ("memory_mib", "memory, MiB"),
    ("files", "open files"),
    ("threads", "threads"),
    ("load", "load of the machine"),
)


def draw_soak(soak: Soak, path: Path) -> None:
    """A panel for each thing that must not grow, and the machine's load beside them."""
    figure, panels = plt.subplots(
        len(_PANELS) + 1, 1, figsize=(8.5, 9.5), sharex=True, layout="constrained"
    )
    minutes = [moment.seconds / 60 for moment in soak.moments]
    for axes, (name, label) in zip(panels, _PANELS, strict=False):
        axes.plot(minutes, [getattr(moment, name) for moment in soak.moments], color="#30638e", lw=1)
        axes.set_ylim(bottom=0)
        axes.set_ylabel(label)
        axes.grid(alpha=0.25)
    middles = (np.arange(POINTS) + 0.5) * soak.seconds / POINTS / 60
    for asked in soak.asked:
        p99 = p99_by_interval(asked, soak.seconds)
        if np.isfinite(p99).any():
            panels[-1].plot(middles, p99, "o-", ms=3, lw=1, label=asked.name)
    panels[-1].set_ylabel("p99, ms")
    panels[-1].set_yscale("log")
    panels[-1].grid(which="both", alpha=0.25)
    if panels[-1].get_lines():
        panels[-1].legend(fontsize=8, frameon=False)
    panels[-1].set_xlabel("minutes")
    figure.savefig(path, dpi=100)
    plt.close(figure)
