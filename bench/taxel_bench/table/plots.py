"""The plots of `bench table`."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import matplotlib as mpl

mpl.use("Agg")

from matplotlib import pyplot as plt
from matplotlib.axis import Axis
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

Result = dict[str, Any]

_MARKERS: Final = {"network-b": "s", "xgb": "^", "ffnn": "o", "transformer": "D"}


@dataclass(frozen=True)
class _Series:
    """What is drawn in one colour.

    Attributes:
        engine: whose results have it.
        time_ms: the time of a call in a result.
        parameters: the model's size in a result.
        face: colour inside a marker.
    """

    label: str
    colour: str
    engine: str
    time_ms: Callable[[Result], float]
    parameters: Callable[[Result], int] = lambda result: result["parameters"]
    face: str | None = None


_PUBLISHED: Final = _Series(
    *("published, another machine", "#808080", "paper"),
    lambda result: result["published"]["inference_ms_all_channels"],
    lambda result: result["published"]["parameters"],
    face="none",
)
_MEASURED: Final = (
    _Series("published way, here", "#d1495b", "paper", lambda result: result["median_ms"]),
    _Series("Taxel, caches cold", "#30638e", "taxel", lambda result: result["median_ms"]),
    _Series("Taxel, warm", "#5fa8d3", "taxel", lambda result: result["warm_median_ms"]),
)


def draw_time_against_parameters(results: Sequence[Result], path: Path) -> None:
    """Time of one window against the model's size, every model and engine: the paper's figure again."""
    figure, axes = plt.subplots(figsize=(9, 5.2), layout="constrained")
    single = [result for result in results if result["batch"] == 1]
    series = (_PUBLISHED, *_MEASURED)
    for each in series:
        for result in (result for result in single if result["engine"] == each.engine):
            place = each.parameters(result) / 1e6, each.time_ms(result)
            face, marker = each.face or each.colour, _MARKERS[result["model"]]
            axes.plot(*place, marker, color=each.colour, mfc=face, ms=7, alpha=0.85)
    axes.set_xscale("log")
    axes.set_yscale("log")
    _plain_numbers(axes.xaxis)
    _plain_numbers(axes.yaxis)
    axes.set_xlabel("parameters, millions (of trees: nodes)")
    axes.set_ylabel("one window, all 21 channels, ms")
    axes.grid(which="both", alpha=0.2)
    handles = [_sample(each.label, "o", each.colour, each.face or each.colour) for each in series]
    models = dict.fromkeys(result["model"] for result in single)
    handles += [_sample(model, _MARKERS[model], "#333333", "#333333") for model in models]
    figure.legend(handles=handles, loc="outside right upper", frameon=False)
    figure.savefig(path, dpi=120)
    plt.close(figure)


def _sample(label: str, marker: str, colour: str, face: str) -> Line2D:
    return Line2D([], [], color=colour, marker=marker, mfc=face, ls="", label=label)


def draw_latency_against_batch(results: Sequence[Result], path: Path) -> None:
    """A panel a model: how long a call takes against the windows in it, at the first combination."""
    first = results[0]["inputs"]
    shown = [result for result in results if result["inputs"] == first]
    models = list(dict.fromkeys(result["model"] for result in shown))
    figure, grid = plt.subplots(
        1,
        len(models),
        figsize=(1.5 + 2.9 * len(models), 3.8),
        sharey=True,
        squeeze=False,
        layout="constrained",
    )
    for axes, model in zip(grid[0], models, strict=True):
        own = [result for result in shown if result["model"] == model]
        batches = sorted({result["batch"] for result in own})
        for each in _MEASURED:
            times = [each.time_ms(result) for result in own if result["engine"] == each.engine]
            axes.plot(batches, times, "o-", ms=4, color=each.colour, label=each.label)
        axes.set_xscale("log", base=2)
        axes.set_yscale("log")
        axes.minorticks_off()
        _plain_numbers(axes.yaxis)
        axes.set_xticks(batches, [str(batch) for batch in batches])
        axes.set_title(model)
        axes.set_xlabel("windows a call")
        axes.grid(alpha=0.25)
    grid[0][0].set_ylabel("median of a call, ms")
    grid[0][0].legend(fontsize=8)
    figure.savefig(path, dpi=120)
    plt.close(figure)


def _plain_numbers(axis: Axis) -> None:
    """Numbers such as 0.02, 1 and 50 along a logarithmic axis."""
    axis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axis.set_minor_formatter(NullFormatter())
