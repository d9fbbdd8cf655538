"""A study's pictures: errors by channel, input combination and given temperature, and losses."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from taxel.channels import CHANNELS
from taxel_models.study.cell import CellResult
from taxel_models.study.study_settings import SWEPT
from taxel_models.study.summary import MEAN_PREDICTOR, Summary
from taxel_models.study.temperature import Temperature

COLOURS: Final = ("#6c757d", "#30638e", "#d1495b", "#edae49", "#00798c", "#7b2d8b")
"""One for each model, in the order of the settings."""

_GROUP: Final = 0.8
"""Share of the room between two ticks that boxes or bars take."""


def draw_channels(summary: Summary, combination: int, path: Path) -> None:
    """Boxes of the folds' normalised MAE: a group for each channel, a box for each model."""
    figure = Figure(figsize=(14, 4.5), layout="constrained")
    axes = figure.subplots()
    for place, model in enumerate(summary.models):
        folds = summary.entries[model, combination].folds
        _boxes(axes, np.array([fold.test.norm_mae for fold in folds]), place, summary.models)
    _finish(axes, CHANNELS, "channel", summary.models)
    axes.set_title(f"Input combination {combination}, protocol {summary.protocol}: {len(folds)} folds")
    figure.savefig(path, dpi=110, format="png")


def draw_combination_boxes(summary: Summary, path: Path) -> None:
    """Boxes of the folds' normalised MAE over all channels: a group for each input combination."""
    figure = Figure(figsize=(11, 4.5), layout="constrained")
    axes = figure.subplots()
    for place, model in enumerate(summary.models):
        values = [summary.entries[model, number].values("norm_mae") for number in summary.combinations]
        _boxes(axes, np.array(values).T, place, summary.models)
    _finish(axes, [str(number) for number in summary.combinations], "input combination", summary.models)
    axes.set_title(f"Folds, all 21 channels, protocol {summary.protocol}")
    figure.savefig(path, dpi=110, format="png")


def draw_combination_bars(summary: Summary, path: Path) -> None:
    """Mean normalised MAE and its standard deviation over folds: a group for each input combination."""
    figure = Figure(figsize=(11, 4.5), layout="constrained")
    axes = figure.subplots()
    ticks = np.arange(len(summary.combinations))
    width = _GROUP / len(summary.models)
    for place, model in enumerate(summary.models):
        values = [summary.entries[model, number].values("norm_mae") for number in summary.combinations]
        axes.bar(
            ticks + _offset(place, len(summary.models)),
            np.mean(values, axis=1),
            0.9 * width,
            yerr=np.std(values, axis=1),
            color=_colour(place),
            error_kw={"lw": 1, "capsize": 2},
        )
    _finish(axes, [str(number) for number in summary.combinations], "input combination", summary.models)
    axes.set_title(f"Mean and standard deviation over folds, protocol {summary.protocol}")
    figure.savefig(path, dpi=110, format="png")


def draw_losses(summary: Summary, model: str, path: Path) -> None:
    """Training (solid) and validation loss (dashed), mean over the folds that still train."""
    figure = Figure(figsize=(9, 4.5), layout="constrained")
    axes = figure.subplots()
    shades = [f"C{number}" for number in range(len(summary.combinations))]
    for shade, combination in zip(shades, summary.combinations, strict=True):
        folds = summary.entries[model, combination].folds
        for part, style in (("train", "-"), ("validation", "--")):
            steps = _mean_losses(folds, part)
            if steps:
                label = f"inputs {combination}" if part == "validation" else None
                axes.plot(range(1, len(steps) + 1), steps, style, color=shade, lw=1.1, label=label)
    history = folds[0].history
    axes.set_xlabel(history.unit)
    axes.set_ylabel(history.loss)
    axes.grid(alpha=0.3)
    known = "training solid, validation dashed" if history.train else "validation"
    axes.set_title(f"{model}, protocol {summary.protocol}: {known}")
    axes.legend(ncols=2, fontsize="small")
    figure.savefig(path, dpi=110, format="png")


def draw_temperature(found: Temperature, path: Path) -> None:
    """Normalised MAE over Network B's given temperature; shaded: the folds' standard deviation."""
    figure = Figure(figsize=(9, 4.5), layout="constrained")
    axes = figure.subplots()
    fixed = f"any one of {len(found.tdc)} that occur"
    _band(axes, found.tdc, found.norm_mae, COLOURS[1], "-", fixed)
    measured = np.broadcast_to(found.measured.norm_mae[:, None], found.norm_mae.shape)
    _band(axes, found.tdc, measured, COLOURS[2], "--", "as measured")
    naive = float(found.mean_predictor.norm_mae.mean())
    axes.axhline(naive, color=COLOURS[0], ls=":", lw=1.4, label=MEAN_PREDICTOR)
    axes.axvline(found.mean.tdc, color="black", ls="-.", lw=1, label=f"mean, {found.mean.tdc:.1f}")
    best = found.best
    lowest = best.errors.norm_mae.mean()
    axes.plot([best.tdc], [lowest], "o", ms=5, color=COLOURS[1], label=f"best, {best.tdc:.0f}")
    axes.set_xlabel("given temperature, tdc counts")
    axes.set_ylabel("normalised MAE")
    axes.set_ylim(bottom=0)
    axes.margins(x=0.01)
    axes.grid(alpha=0.3)
    axes.set_title(f"{SWEPT[0]}, inputs {SWEPT[1]}, protocol {found.protocol}: {len(found.norm_mae)} folds")
    axes.legend(fontsize="small", loc="upper left", bbox_to_anchor=(1, 1))
    figure.savefig(path, dpi=110, format="png")


def _band(axes: Axes, places: Any, values: Any, colour: str, style: str, label: str) -> None:
    """The mean of (folds, k) and, shaded, its standard deviation over folds."""
    mean, std = values.mean(axis=0), values.std(axis=0)
    axes.plot(places, mean, style, color=colour, lw=1.4, label=label)
    axes.fill_between(places, mean - std, mean + std, color=colour, alpha=0.2, lw=0)


def _mean_losses(folds: Sequence[CellResult], part: str) -> list[float]:
    curves: list[Sequence[float]] = [getattr(fold.history, part) for fold in folds]
    longest = max(map(len, curves))
    return [
        float(np.mean([curve[step] for curve in curves if step < len(curve)])) for step in range(longest)
    ]


def _boxes(axes: Axes, values: Any, place: int, models: Sequence[str]) -> None:
    """Draw (folds, groups) as one box a group, `place`th of its group."""
    boxes = axes.boxplot(
        values,
        positions=np.arange(values.shape[1]) + _offset(place, len(models)),
        widths=0.8 * _GROUP / len(models),
        patch_artist=True,
        manage_ticks=False,
        medianprops={"color": "black", "lw": 1},
        flierprops={"marker": ".", "ms": 3},
    )
    for box in boxes["boxes"]:
        box.set_facecolor(_colour(place))


def _offset(place: int, models: int) -> float:
    return _GROUP * ((place + 0.5) / models - 0.5)


def _colour(place: int) -> str:
    return COLOURS[place % len(COLOURS)]


def _finish(axes: Axes, ticks: Sequence[str], label: str, models: Sequence[str]) -> None:
    axes.set_xticks(range(len(ticks)), ticks)
    axes.set_xlim(-0.5, len(ticks) - 0.5)
    axes.set_xlabel(label)
    axes.set_ylabel("normalised MAE")
    axes.set_ylim(0, 1.1 * axes.get_ylim()[1])
    axes.set_axisbelow(True)
    axes.grid(axis="y", alpha=0.3)
    for edge in range(1, len(ticks)):
        axes.axvline(edge - 0.5, color="#dddddd", lw=0.6)
    handles = [Patch(facecolor=_colour(place), label=model) for place, model in enumerate(models)]
    axes.legend(handles=handles, ncols=len(models), loc="upper left", fontsize="small")
