"""A picture of each named effect: the residual against what drives it, before and after."""

from collections.abc import Callable
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy import stats

from taxel.channels import CHANNELS
from taxel.windows.history import TICK_S, TOUCH_N
from taxel_models.loop.basis import Floats, Shared
from taxel_models.loop.effects.fault import Fault
from taxel_models.loop.effects.interference import Interference
from taxel_models.loop.effects.location import Location
from taxel_models.loop.effects.offset import Offset
from taxel_models.loop.inference.contact_offset import ContactOffset
from taxel_models.loop.pipeline import LoopResult
from taxel_models.loop.report.drawing import AFTER, BEFORE, MEASURED, Drawing
from taxel_models.loop.report.drivers import axis_of
from taxel_models.loop.report.partial import Partial
from taxel_models.loop.report.signature_pictures import draw_contact_offset, draw_interference

_BINS: Final = 14
_LEAST_ROWS: Final = 12
"""A bin with fewer is not drawn."""

_MOST_KINDS: Final = 12
"""So few values are drawn one by one."""

_ASIDE: Final = 0.08
"""Of the least distance between values: so far before and after stand apart."""

_OUTER: Final = (0.005, 0.995)
"""Quantiles of the driver that are drawn."""

_TRACE_ROWS: Final = 3000


def draw_effect(result: LoopResult, partial: Partial) -> Drawing:
    """Draw an effect in the way that shows it best."""
    if partial.named.name == ContactOffset.name:
        return draw_contact_offset(result, partial)
    if partial.kind == Offset.name and not isinstance(partial.named.candidate.basis, Shared):
        # An offset of each contact has no mean to speak of.
        return _against_driver(result, partial)
    return _WAYS.get(partial.kind, _against_driver)(result, partial)


def _against_driver(result: LoopResult, partial: Partial) -> Drawing:
    figure, panels = _panels(len(partial.channels))
    for panel, channel in zip(panels, partial.channels, strict=True):
        axis = axis_of(result, partial, channel)
        for residual, colour, label in (
            (partial.before[:, channel], BEFORE, "before"),
            (partial.after[:, channel], AFTER, "after"),
        ):
            _band(panel, axis.values, residual, colour, label)
        panel.axhline(0, color="black", lw=0.7)
        panel.set_title(CHANNELS[channel])
        panel.set_xlabel(axis.label, fontsize="small")
        panel.grid(alpha=0.3)
    panels[0].set_ylabel("residual, counts")
    panels[0].legend()
    return figure, (
        "Residual against what drives the effect: median and middle half of the evaluation part's rows, "
        "in the channels that it changes most. Before: what the other named effects leave. After, the "
        "line should be flat at 0."
    )


def _band(panel: Axes, values: Floats, residual: Floats, colour: str, label: str) -> None:
    """Medians with the middle half as a band; a point and a bar a value where there are few values."""
    kinds = np.unique(values)
    if len(kinds) <= _MOST_KINDS:
        low, middle, high = _quartiles([residual[values == kind] for kind in kinds])
        aside = (-_ASIDE if label == "before" else _ASIDE) * np.diff(kinds, append=kinds[-1] + 1).min()
        reach = [middle - low, high - middle]
        panel.errorbar(kinds + aside, middle, reach, fmt="o", color=colour, label=label)
        panel.set_xticks(kinds)
        return
    lowest, highest = np.quantile(values, _OUTER)
    edges = np.linspace(lowest, highest, _BINS + 1)
    places = np.digitize(values, edges) - 1
    inside = [place for place in range(_BINS) if (places == place).sum() >= _LEAST_ROWS]
    low, middle, high = _quartiles([residual[places == place] for place in inside])
    centres = (edges[:-1] + edges[1:])[inside] / 2
    panel.plot(centres, middle, "o-", ms=3, lw=1.4, color=colour, label=label)
    panel.fill_between(centres, low, high, color=colour, alpha=0.2, lw=0)


def _quartiles(groups: list[Floats]) -> tuple[Floats, Floats, Floats]:
    if not groups:
        return np.empty(0), np.empty(0), np.empty(0)
    low, middle, high = np.array([np.quantile(group, (0.25, 0.5, 0.75)) for group in groups]).T
    return low, middle, high


def _means(result: LoopResult, partial: Partial) -> Drawing:
    """A bar a channel: means over blocks with their 95 % intervals."""
    figure = Figure(figsize=(10, 3.8), layout="constrained")
    axes = figure.subplots()
    blocks = result.blocks.of_row[partial.rows]
    for shift, residual, colour, label in (
        (-0.2, partial.before, BEFORE, "before"),
        (0.2, partial.after, AFTER, "after"),
    ):
        means = np.array([residual[blocks == block].mean(axis=0) for block in np.unique(blocks)])
        reach = stats.t.ppf(0.975, len(means) - 1) * means.std(axis=0, ddof=1) / np.sqrt(len(means))
        places = np.arange(len(CHANNELS)) + shift
        axes.bar(places, means.mean(axis=0), 0.4, yerr=reach, color=colour, label=label, error_kw={"lw": 1})
    axes.axhline(0, color="black", lw=0.7)
    axes.set_xticks(range(len(CHANNELS)), CHANNELS)
    axes.set_ylabel("mean residual, counts")
    axes.legend()
    axes.grid(axis="y", alpha=0.3)
    return figure, (
        "Mean residual of each channel over the evaluation part's blocks, with 95 % intervals. Before: "
        "what the other named effects leave. After, the bars should vanish."
    )


def _map(result: LoopResult, partial: Partial) -> Drawing:
    """Mean absolute residual over where the contact is, in the two directions in which it moves most."""
    touched = result.observations.pressed[partial.rows] > TOUCH_N
    position = result.observations.position[partial.rows][touched] * 1e3
    across, up = sorted(np.argsort(position.std(axis=0))[-2:])
    columns = list(partial.channels)
    scale = np.array(result.observations.manifest.normalisation.output_std)[columns]
    sizes = [
        (np.abs(residual[touched][:, columns]) / scale).mean(axis=1)
        for residual in (partial.before, partial.after)
    ]
    most = float(np.quantile(sizes[0], 0.95))
    figure, panels = _panels(2, width=4.2, height=3.8)
    for panel, size, label in zip(panels, sizes, ("before", "after"), strict=True):
        drawn = panel.hexbin(
            position[:, across], position[:, up], C=size, gridsize=18, vmin=0, vmax=most, cmap="magma_r",
            mincnt=3,
        )  # fmt: skip
        panel.set_title(label)
        panel.set_xlabel(f"{'xyz'[across]} of the contact, mm")
        panel.set_aspect("equal", adjustable="datalim")
    panels[0].set_ylabel(f"{'xyz'[up]} of the contact, mm")
    figure.colorbar(drawn, ax=panels, label="mean |residual| / SD of the channel")
    return figure, (
        "Mean absolute residual over where the contact is, on the evaluation part, in "
        f"{', '.join(partial.channel_names)}. Before: what the other named effects leave. After, no place "
        "should stand out."
    )


def _traces(result: LoopResult, partial: Partial) -> Drawing:
    """Half a minute around where the fault first shows."""
    contribution, observations = partial.named.contribution, result.observations
    columns = _changed_most(contribution)
    figure = Figure(figsize=(10, 0.7 + 1.9 * len(columns)), layout="constrained")
    panels = figure.subplots(len(columns), 1, squeeze=False)[:, 0]
    for panel, channel in zip(panels, columns, strict=True):
        first = max(0, int(np.argmax(contribution[:, channel] != 0)) - _TRACE_ROWS // 3)
        rows = slice(first, first + _TRACE_ROWS)
        seconds = TICK_S * np.arange(first, min(first + _TRACE_ROWS, len(observations)), dtype=np.float64)
        panel.plot(seconds, observations.predicted[rows, channel], color=BEFORE, lw=1, label="model")
        panel.plot(seconds, observations.measured[rows, channel], color=MEASURED, lw=1.2, label="measured")
        _shade(panel, seconds, contribution[rows, channel] != 0)
        panel.set_ylabel(f"{CHANNELS[channel]}, counts")
        panel.grid(alpha=0.3)
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper right", ncols=3)
    panels[-1].set_xlabel("seconds of rows, gaps left out")
    return figure, "Channels with a fault where it first shows; shaded, where it acts."


def _changed_most(contribution: Floats) -> NDArray[np.int64]:
    energy = (contribution**2).mean(axis=0)
    return np.flatnonzero((energy > 0) & (energy >= np.sort(energy)[-4]))


def _shade(panel: Axes, seconds: Floats, faulty: NDArray[np.bool_]) -> None:
    low, high = panel.get_ylim()
    panel.fill_between(seconds, low, high, where=faulty, color=AFTER, alpha=0.15, lw=0, label="fault")
    panel.set_ylim(low, high)


def _panels(count: int, width: float = 3.1, height: float = 3.3) -> tuple[Figure, list[Axes]]:
    figure = Figure(figsize=(max(width * count, 4.5), height), layout="constrained")
    return figure, list(figure.subplots(1, count, squeeze=False)[0])


_WAYS: Final[dict[str, Callable[[LoopResult, Partial], Drawing]]] = {
    Offset.name: _means,
    Location.name: _map,
    Fault.name: _traces,
    Interference.name: draw_interference,
}
