"""Effects that cannot be told apart, as a graph."""

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch
from matplotlib.path import Path as Curve

from taxel_models.loop.findings import Findings
from taxel_models.loop.report.drawing import AFTER, NOISE, Drawing
from taxel_models.loop.report.numbers import percent

_FREE = "told apart from all others"


def draw_confounded(findings: Findings) -> Drawing:
    """Named effects on the left, those that could stand in their place on the right."""
    rows = {effect.name: float(row) for row, effect in enumerate(findings.effects)}
    pairs = {
        tuple(sorted((effect.name, other))): (effect.name, other)
        for effect in findings.effects
        for other in effect.confounded_with
    }.values()
    tied = {name for pair in pairs for name in pair}
    others = _places({other for _, other in pairs} - set(rows), list(pairs), rows)
    height = max(len(rows), len(others), 2)
    figure = Figure(figsize=(7, 1.1 + 0.55 * height), layout="constrained")
    axes = figure.subplots()
    for name, other in pairs:
        _join(axes, rows[name], rows.get(other), others.get(other, 0.0))
    for effect in findings.effects:
        label = f"{effect.name}, {percent(effect.explained)}"
        _box(axes, 0.0, rows[effect.name], label, named=True)
        if effect.name not in tied:
            style = {"facecolor": "white", "edgecolor": "none", "pad": 1.0}
            axes.text(0.3, rows[effect.name], _FREE, va="center", fontsize=8, color=NOISE, bbox=style)
    for name, y in others.items():
        _box(axes, 1.0, y, name, named=False)
    for x, title in ((0.0, "named, and what it explains"), (1.0, "could stand in its place")):
        axes.text(x, -0.9, title, ha="center", va="center", fontsize=9, color=NOISE)
    low = min([0.0, *others.values()])
    axes.set(xlim=(-0.65, 1.4), ylim=(max([*rows.values(), *others.values()]) + 0.6, min(low, 0.0) - 1.2))
    axes.axis("off")
    return figure, (
        "Filled: the effects that were named, in this order. A line: the other effect would explain "
        "at least two thirds as much in its place on held-out folds, so that the recording cannot tell the "
        "two apart."
    )


def _places(others: set[str], pairs: list[tuple[str, str]], rows: dict[str, float]) -> dict[str, float]:
    """Heights of the effects on the right: near those that they are tied to, so that few lines cross."""
    ties = {name: [rows[left] for left, other in pairs if other == name] for name in others}
    ordered = sorted(others, key=lambda name: (sum(ties[name]) / len(ties[name]), name))
    middle = sum(height for tied in ties.values() for height in tied) / max(sum(map(len, ties.values())), 1)
    first = max(middle - (len(ordered) - 1) / 2, 0.0)
    return {name: first + place for place, name in enumerate(ordered)}


def _join(axes: Axes, y: float, named_y: float | None, other_y: float) -> None:
    """A straight line to the right; between two named effects, around those that lie between them."""
    if named_y is None:
        axes.plot([0.0, 1.0], [y, other_y], color=NOISE, lw=2, zorder=1)
        return
    out = 0.0 if abs(y - named_y) == 1.0 else -0.95
    points = [(0.0, y), (out, (y + named_y) / 2), (0.0, named_y)]
    curve = Curve(points, [Curve.MOVETO, Curve.CURVE3, Curve.CURVE3])
    axes.add_patch(PathPatch(curve, fill=False, edgecolor=NOISE, lw=2, zorder=1))


def _box(axes: Axes, x: float, y: float, text: str, *, named: bool) -> None:
    style = {"boxstyle": "round,pad=0.4", "facecolor": AFTER if named else "white", "edgecolor": AFTER}
    axes.text(
        x, y, text, ha="center", va="center", color="white" if named else "black", bbox=style, zorder=2
    )
