"""The skin of a BioTac 2P as a surface: a cylinder along -x, closed by a hemisphere for x > 0.

The sensor's frame: x points along the finger to its tip, z out of the nail, y to the side; the origin
lies on the cylinder's axis, where the hemisphere begins. The underside, the middle of the pad, is at -z.

Functions take lengths in any one unit; `Fingertip` has metres. A place on the skin has two coordinates.
`along` is the arc length from the seam between cylinder and hemisphere: negative on the cylinder, up to a
quarter circle at the tip. `around` is the angle about the x axis, 0 at the underside (-z), positive
towards +y.
"""

import json
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any, Final, Self

import numpy as np
from numpy.typing import NDArray

_M: Final = 1e-3
"""Metres in a millimetre."""


@cache
def published_geometry() -> dict[str, Any]:
    """The published figures of one BioTac 2P, mm; the file names the source of each."""
    figures: dict[str, Any] = json.loads(
        (files(__package__) / "biotac_2p.json").read_text(encoding="utf-8")
    )
    return figures


@dataclass(frozen=True)
class Fingertip:
    """The shape of a fingertip, in the sensor's frame.

    Attributes:
        radius: of the cylinder and of the hemisphere, m.
        electrodes: (19, 3), the places of e1 to e19 on the core under the skin, m.
        normals: (19, 3), unit vectors out of the core.
    """

    radius: float
    electrodes: NDArray[np.float64]
    normals: NDArray[np.float64]

    @classmethod
    @cache
    def biotac_2p(cls) -> Self:
        """The sensor of the paper's data set; published normals are rounded, so they are rescaled to 1."""
        figures = published_geometry()
        places = np.array([electrode["position_mm"] for electrode in figures["electrodes"]], dtype=float)
        normals = np.array([electrode["normal"] for electrode in figures["electrodes"]], dtype=float)
        return cls(
            radius=float(figures["skin_radius_mm"]) * _M,
            electrodes=places * _M,
            normals=normals / np.linalg.norm(normals, axis=1, keepdims=True),
        )

    def height(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Signed distance of points (n, 3), m, from the skin: (n,) m, positive outside."""
        return height_above_skin(points, self.radius)

    def normal(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Unit vectors (n, 3) from the axis of the finger to points (n, 3); of a point on the axis, -z."""
        return _unit(off_axis(points))

    def nearest(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """The places (n, 3) on the skin nearest to points (n, 3), m."""
        away = off_axis(points)
        return np.asarray(points - away + self.radius * _unit(away))


def off_axis(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Vectors (n, 3) to points (n, 3) from the nearest place of the cylinder's axis, x <= 0."""
    away = np.array(points, dtype=np.float64)
    away[:, 0] = np.maximum(away[:, 0], 0.0)
    return away


def _unit(away: NDArray[np.float64]) -> NDArray[np.float64]:
    """Vectors (n, 3) at length 1; for zero, -z."""
    length = lengths(away)[:, None]
    if length.all():
        return away / length
    down = np.array([0.0, 0.0, -1.0])
    return np.where(length > 0.0, away / np.where(length > 0.0, length, 1.0), down)


def lengths(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Of vectors (…, 3); the bits of `np.linalg.norm`, at a third of its cost for a few."""
    return np.asarray(np.sqrt(np.add.reduce(vectors * vectors, axis=-1)))


@dataclass(frozen=True)
class Patch:
    """Places on the skin with their local frames, each (n, 3): a point, and unit vectors.

    Attributes:
        point: on the skin.
        normal: out of the skin.
        forward: tangent, towards the tip.
        sideways: tangent, towards growing `around`.
    """

    point: NDArray[np.float64]
    normal: NDArray[np.float64]
    forward: NDArray[np.float64]
    sideways: NDArray[np.float64]


def patch(along: NDArray[np.float64], around: NDArray[np.float64], radius: float) -> Patch:
    """The places on the skin at the coordinates `along` and `around` (rad), each (n,)."""
    latitude = np.maximum(along, 0.0) / radius
    rise, run = np.sin(latitude), np.cos(latitude)
    y, z = np.sin(around), -np.cos(around)
    normal = np.column_stack([rise, run * y, run * z])
    point = radius * normal
    point[:, 0] += np.minimum(along, 0.0)
    forward = np.column_stack([run, -rise * y, -rise * z])
    sideways = np.column_stack([np.zeros_like(y), -z, y])
    return Patch(point, normal, forward, sideways)


def height_above_skin(points: NDArray[np.float64], radius: float) -> NDArray[np.float64]:
    """Signed distance of points (n, 3) from the skin: positive outside."""
    return np.asarray(lengths(off_axis(points)) - radius)


def gap_to_skin(
    origins: NDArray[np.float64], normals: NDArray[np.float64], radius: float
) -> NDArray[np.float64]:
    """Distance from points inside the skin to it, along their normals.

    Rays that start at x > 0 must lead forward, and others across the axis, as the electrodes' do:
    then each meets one of the two parts of the surface only.
    """
    start = off_axis(origins)
    inward = np.einsum("ij,ij->i", start, normals)
    return np.asarray(-inward + np.sqrt(inward**2 + radius**2 - np.einsum("ij,ij->i", start, start)))


PAD: Final = (0.0, 0.0, -Fingertip.biotac_2p().radius)
"""The middle of the pad, m: where a fingertip is said to be touched that nothing has touched yet."""
