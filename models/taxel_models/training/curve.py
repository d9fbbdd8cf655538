"""The loss curve of a training."""

from pathlib import Path

from taxel_models.families.family import History


def draw_history(history: History, path: Path) -> None:
    """Draw the training and validation loss over steps, and mark the step of the kept weights.

    Args:
        history: how fitting went.
        path: the picture to write.
    """
    # Not with the module: whoever only reads a trained model draws nothing.
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7, 4), layout="constrained")
    axes = figure.subplots()
    parts = (("train", history.train, "#30638e"), ("validation", history.validation, "#d1495b"))
    for part, losses, colour in parts:
        if losses:
            axes.plot(range(1, len(losses) + 1), losses, color=colour, label=part)
    axes.axvline(history.best, color="#444444", ls=":", label=f"kept: {history.best}")
    axes.set_xlabel(history.unit)
    axes.set_ylabel(history.loss)
    axes.set_yscale("log")
    axes.grid(alpha=0.3, which="both")
    axes.legend()
    figure.savefig(path, dpi=110)
