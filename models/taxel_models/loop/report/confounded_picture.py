"""Effects that cannot be told apart, as a graph."""

from pathlib import Path

from matplotlib.figure import Figure

from taxel_models.loop.findings import Findings
from taxel_models.loop.report.colours import AFTER, NOISE


def draw_confounded(findings: Findings, path: Path) -> str:
    """Named effects on the left, those that could stand in their place on the right.

    Returns:
        A caption.
    """
    named = [effect.name for effect in findings.effects]
    others = sorted({name for effect in findings.effects for name in effect.confounded_with} - set(named))
    height = max(len(named), len(others), 2)
    places = {name: (0.0, y) for name, y in zip(named, _spread(len(named), height), strict=True)}
    places |= {name: (1.0, y) for name, y in zip(others, _spread(len(others), height), strict=True)}
    figure = Figure(figsize=(7, 0.8 + 0.6 * height), layout="constrained")
    axes = figure.subplots()
    for effect in findings.effects:
        for other in effect.confounded_with:
            (x, y), (to_x, to_y) = places[effect.name], places[other]
            axes.plot([x, to_x], [y, to_y], color=NOISE, lw=2, zorder=1)
    for name, (x, y) in places.items():
        style = {
            "boxstyle": "round,pad=0.4",
            "facecolor": AFTER if name in named else "white",
            "edgecolor": AFTER,
        }
        colour = "white" if name in named else "black"
        axes.text(x, y, name, ha="center", va="center", color=colour, bbox=style, zorder=2)
    axes.set(xlim=(-0.5, 1.5), ylim=(-0.6, height - 0.4))
    axes.invert_yaxis()
    axes.axis("off")
    figure.savefig(path, dpi=110, format="png")
    return (
        "Filled: the effects that were named. A line: the other effect would explain at least 80 % as much "
        "in its place on held-out folds, so that the recording cannot tell the two apart."
    )


def _spread(count: int, height: int) -> list[float]:
    """So many places, in the middle of the height."""
    return [(height - count) / 2 + place for place in range(count)]
