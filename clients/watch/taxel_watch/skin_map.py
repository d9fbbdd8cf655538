"""The unrolled skin: a flat map of the fingertip, mm.

`across` runs to the side, positive towards +y; `along` runs to the tip, 0 at the seam between cylinder and
hemisphere. On the hemisphere, circles of latitude keep their length (the sinusoidal projection), so that
the map ends in a point at the tip, and areas are true.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from taxel.skin import Fingertip, patch

MM: Final = 1e3

_EDGE: Final = np.radians(105.0)
"""How far around the skin reaches on the map: past its outermost electrodes, at 77 degrees."""

_END_M: Final = -0.0165
"""How far back the map reaches, m: past the electrode e19."""


def coordinates(
    points: NDArray[np.float64], radius: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """`along`, m, and `around`, rad, of the places on the skin nearest to points (n, 3), m."""
    x, y, z = points.T
    ahead = np.maximum(x, 0.0)
    along = np.where(x > 0.0, radius * np.arctan2(ahead, np.hypot(y, z)), x)
    return along, np.arctan2(y, -z)


def flat(along: NDArray[np.float64], around: NDArray[np.float64], radius: float) -> NDArray[np.float64]:
    """Places on the map, (n, 2): `across` and `along`, mm."""
    narrower = np.cos(np.maximum(along, 0.0) / radius)
    return MM * np.column_stack([radius * around * narrower, along])


def on_map(points: NDArray[np.float64], tip: Fingertip) -> NDArray[np.float64]:
    """Where points (n, 3), m, lie on the map, (n, 2) mm."""
    return flat(*coordinates(points, tip.radius), tip.radius)


def electrodes_on_map(tip: Fingertip) -> NDArray[np.float64]:
    """The places on the skin nearest to e1 to e19, which lie on the core under it, (19, 2) mm."""
    return on_map(tip.electrodes, tip)


def outline(tip: Fingertip) -> NDArray[np.float64]:
    """The edge of the map, (n, 2) mm, without repeating its first place."""
    cap = np.linspace(0.0, tip.radius * np.pi / 2, 24)
    along = np.concatenate([[_END_M], cap, cap[-2::-1], [_END_M]])
    around = np.concatenate([np.full(25, -_EDGE), np.full(len(along) - 25, _EDGE)])
    return flat(along, around, tip.radius)


def force_on_map(
    position: NDArray[np.float64], force: NDArray[np.float64], tip: Fingertip
) -> NDArray[np.float64]:
    """Forces on the finger (n, 3), N, at positions (n, 3), m, seen from the skin.

    Returns:
        (n, 3) N: into the skin, across (towards +y around the finger) and along (towards the tip).
    """
    places = patch(*coordinates(position, tip.radius), tip.radius)

    def part(direction: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(np.einsum("ij,ij->i", force, direction))

    return np.column_stack([-part(places.normal), part(places.sideways), part(places.forward)])
