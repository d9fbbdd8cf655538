"""A picture of a search: the cost of every search trial, and the best so far."""

from typing import BinaryIO

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from taxel_models.search.objective import WORST
from taxel_models.search.run import Outcome


def draw_trials(outcome: Outcome, title: str, file: BinaryIO) -> None:
    """Draw the cost of each trial by its epochs, and the incumbent's as a line.

    Args:
        outcome: result of the search.
        title: title of the picture.
        file: to write the PNG picture to.
    """
    figure = Figure(figsize=(8, 4), layout="constrained")
    axis = figure.subplots()
    budgets = sorted({trial.epochs or 0 for trial in outcome.trials})
    colours = mpl.colormaps["viridis"](np.linspace(0.85, 0.1, len(budgets)))
    for budget, colour in zip(budgets, colours, strict=True):
        shown = [trial for trial in outcome.trials if (trial.epochs or 0) == budget and trial.cost < WORST]
        axis.plot(
            [trial.number for trial in shown],
            [trial.cost for trial in shown],
            "o",
            ms=4,
            color=colour,
            label=f"epochs: {budget}" if budget else "trial",
        )
    steps = [*outcome.incumbents, (len(outcome.trials), outcome.incumbents[-1][1])]
    axis.step(
        [number for number, _ in steps],
        [cost for _, cost in steps],
        where="post",
        color="#d1495b",
        label="best so far",
    )
    axis.set_yscale("log")
    axis.yaxis.set_major_formatter("{x:.3g}")
    axis.yaxis.set_minor_formatter("{x:.3g}")
    axis.set_xlabel("trial")
    axis.set_ylabel("normalised MAE, validation set")
    diverged = sum(trial.cost >= WORST for trial in outcome.trials)
    axis.set_title(title + (f"; {diverged} diverged, not shown" if diverged else ""))
    axis.grid(alpha=0.3, which="both")
    axis.legend()
    figure.savefig(file, format="png", dpi=110)
