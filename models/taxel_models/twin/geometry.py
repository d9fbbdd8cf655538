"""The skin as a surface: a cylinder along -x, closed by a hemisphere for x > 0; lengths in mm.

A place on it has two coordinates. `along` is the arc length from the seam between cylinder and
hemisphere: negative on the cylinder, up to a quarter circle at the tip. `around` is the angle about
the x axis, 0 at the underside (-z), positive towards +y.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Patch:
    """Places on the skin with their local frames, each (n, 3): a point in mm, and unit vectors.

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
    """The places on the skin at the coordinates `along` (mm) and `around` (rad), each (n,)."""
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
    """Signed distance of points (n, 3) from the skin, mm: positive outside."""
    off_axis = points.copy()
    off_axis[:, 0] = np.maximum(off_axis[:, 0], 0.0)
    return np.asarray(np.linalg.norm(off_axis, axis=1) - radius)


def gap_to_skin(
    origins: NDArray[np.float64], normals: NDArray[np.float64], radius: float
) -> NDArray[np.float64]:
    """Distance from points inside the skin to it, along their normals, mm.

    Rays that start at x > 0 must lead forward, and others across the axis, as the electrodes' do:
    then each meets one of the two parts of the surface only.
    """
    start = origins.copy()
    start[:, 0] = np.maximum(start[:, 0], 0.0)
    inward = np.einsum("ij,ij->i", start, normals)
    return np.asarray(-inward + np.sqrt(inward**2 + radius**2 - np.einsum("ij,ij->i", start, start)))
