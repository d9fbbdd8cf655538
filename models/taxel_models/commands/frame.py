"""`taxel frame`: draw the fingertip in the sensor's frame, with its electrodes, axes and signs."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import numpy as np
import typer
from numpy.typing import NDArray

from taxel.atomic import check_file_place, whole_file
from taxel.channels import ELECTRODES
from taxel.dependencies import require
from taxel.skin import Fingertip

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_MM: Final = 1e3
_END_MM: Final = -17.0
"""How far back the body is drawn, mm."""

_FORCE, _SKIN, _AXES = "#c0392b", "#555555", "#2c6fbb"
_KIND = {".svg": "svg", ".png": "png", ".pdf": "pdf"}

Output = Annotated[
    Path, typer.Option("--output", "-o", metavar="PICTURE", help="An .svg, .png or .pdf file.")
]


def frame(output: Output = Path("frame.svg")) -> None:
    """Draw the sensor's frame: places of the electrodes, axes, signs and units."""
    require("a drawing", "plot", "matplotlib")
    check_file_place(output)
    if output.suffix not in _KIND:
        raise typer.BadParameter(f"{output}: expected a name that ends with .svg, .png or .pdf")
    import matplotlib as mpl

    # The same drawing is the same file: no date, and names of parts that do not change.
    with whole_file(output) as place, mpl.rc_context({"svg.hashsalt": "taxel", "svg.fonttype": "none"}):
        metadata = {"Date": None} if output.suffix == ".svg" else None
        drawing().savefig(place, format=_KIND[output.suffix], metadata=metadata)
    print(f"Wrote {output}.")


def drawing() -> "Figure":
    """The fingertip from its side and from below."""
    from matplotlib.figure import Figure

    tip = Fingertip.biotac_2p()
    figure = Figure(figsize=(9.5, 4.4), layout="constrained")
    side, below = figure.subplots(1, 2)
    _view(side, tip, 2)
    _view(below, tip, 1)
    side.set_title("from the side", fontsize=10)
    below.set_title("electrodes, seen through the nail", fontsize=10)
    # A press on the pad: the object pushes the finger up.
    side.annotate(
        "",
        xy=(-6.0, -7.0),
        xytext=(-6.0, -11.5),
        arrowprops={"arrowstyle": "-|>", "color": _FORCE, "lw": 2.0},
    )
    side.text(-5.4, -11.3, "force on the finger: fz > 0, N\nposition: (-0.006, 0, -0.007) m", color=_FORCE)
    side.text(-16.5, 8.1, "nail side", color=_SKIN)
    figure.suptitle("The sensor's frame: positions in m, forces on the finger in N", fontsize=11)
    return figure


def _view(axes: Any, tip: Fingertip, across: int) -> None:
    outline = _outline(tip.radius * _MM)
    axes.plot(*outline.T, color=_SKIN, lw=1.5)
    shown = np.ones(len(ELECTRODES), bool) if across == 1 else tip.electrodes[:, 1] >= 0.0
    places = tip.electrodes[shown] * _MM
    axes.scatter(places[:, 0], places[:, across], s=70, color="#e8c35a", edgecolor=_SKIN, lw=0.6, zorder=3)
    for name, place in zip(np.array(ELECTRODES)[shown], places, strict=True):
        axes.annotate(
            name, (place[0], place[across]), (0, 7), textcoords="offset points", ha="center", fontsize=7
        )
    name = "xyz"[across]
    # In the right view, arrows at the origin would hide electrodes.
    start = np.array([0.0, 0.0] if across == 2 else [-17.0, -9.0])
    for end, label in ((start + np.array([4.5, 0.0]), "x"), (start + np.array([0.0, 4.5]), name)):
        axes.annotate("", xy=end, xytext=start, arrowprops={"arrowstyle": "-|>", "color": _AXES, "lw": 1.6})
        axes.text(end[0] + 0.3, end[1] + 0.3, label, color=_AXES, fontweight="bold")
    axes.set_aspect("equal")
    axes.set_xlabel("x, mm: to the tip")
    axes.set_ylabel(f"{name}, mm")
    axes.set_xlim(_END_MM - 1, 9.5)
    axes.set_ylim(-13, 10) if across == 2 else axes.set_ylim(-10, 10)


def _outline(radius: float) -> NDArray[np.float64]:
    """The skin's outline, (n, 2) mm."""
    turn = np.linspace(-np.pi / 2, np.pi / 2, 60)
    arc = radius * np.column_stack([np.cos(turn), np.sin(turn)])
    return np.vstack([[_END_MM, -radius], arc, [_END_MM, radius]])
