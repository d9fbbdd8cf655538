"""Pictures of a calibration: light contacts on the skin before and after, and nearest electrodes."""

from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from taxel.channels import ELECTRODES
from taxel.skin import height_above_skin
from taxel_models.calibration.calibration import Calibration, distances
from taxel_models.calibration.nearest import NEAR_MM
from taxel_models.twin.sensor import Sensor

_SHOWN_MM: Final = 3.0
"""Larger distances have the colours at the ends of the scale."""


def draw_contacts(calibration: Calibration, sensor: Sensor, path: Path) -> None:
    """Draw light contacts as recorded and as placed, against the skin's outline, from two sides.

    Args:
        calibration: whose contacts.
        sensor: whose skin.
        path: the picture to write.
    """
    rows = (
        ("as recorded", calibration.contacts.position, calibration.fit.before),
        ("in the sensor's frame", calibration.placed, calibration.fit.after),
    )
    figure = Figure(figsize=(11, 7.5), layout="constrained")
    axes = figure.subplots(2, 2)
    for (label, points, heights), (side, profile) in zip(rows, axes, strict=True):
        size = distances(heights)
        along = min(float(points[:, 0].min()), -15.0)
        outline = _outline(sensor.skin_radius, along)
        side.plot(outline[:, 0], outline[:, 1], color="#444444", lw=1.0)
        side.plot(outline[:, 0], -outline[:, 1], color="#444444", lw=1.0)
        image = _dots(side, points[:, 0], points[:, 2], height_above_skin(points, sensor.skin_radius))
        side.set_title(f"{label}: side view")
        side.set_ylabel("z, mm")
        profile.plot(outline[:, 0], outline[:, 1], color="#444444", lw=1.0, label="skin")
        radial = np.hypot(points[:, 1], points[:, 2])
        _dots(profile, points[:, 0], radial, height_above_skin(points, sensor.skin_radius))
        profile.set_title(f"off the skin by {size['mean']:.3f} mm in the mean, median {size['median']:.3f}")
        profile.set_ylabel("distance from the axis, mm")
        profile.legend(loc="lower left")
    for axis in axes.flat:
        axis.set_aspect("equal", adjustable="datalim")
        axis.grid(alpha=0.3)
        axis.set_xlabel("x, mm")
    figure.colorbar(image, ax=axes, label="distance from the skin, mm", extend="both", shrink=0.7)
    figure.savefig(path, dpi=110)


def _outline(radius: float, along: float) -> NDArray[np.float64]:
    """(n, 2): x and distance from the axis, from the tip to x = `along`."""
    angle = np.linspace(0.0, np.pi / 2, 60)
    tip = radius * np.column_stack([np.cos(angle), np.sin(angle)])
    return np.vstack([tip, [[along, radius]]])


def _dots(axis: Any, x: NDArray[np.float64], y: NDArray[np.float64], height: NDArray[np.float64]) -> Any:
    return axis.scatter(x, y, c=height, s=10, cmap="coolwarm", vmin=-_SHOWN_MM, vmax=_SHOWN_MM)


def draw_nearest(calibration: Calibration, path: Path) -> None:
    """Draw how many contacts are nearest to each electrode."""
    nearest = calibration.nearest
    figure = Figure(figsize=(9, 3.6), layout="constrained")
    axis = figure.subplots()
    bars = axis.bar(ELECTRODES, nearest.contacts, color="#30638e")
    axis.bar_label(bars, fontsize=8)
    axis.set_ylabel("contacts")
    axis.set_title(
        f"electrode nearest to where a contact began: {nearest.contacts.sum()} contacts, and "
        f"{nearest.off_skin} more than {NEAR_MM:g} mm off the skin"
    )
    axis.set_axisbelow(True)
    axis.grid(axis="y", alpha=0.3)
    axis.margins(x=0.01, y=0.12)
    figure.savefig(path, dpi=110)
