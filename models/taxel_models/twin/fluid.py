"""The thickness of the fluid over each electrode, and the impedance that follows from it.

An electrode's impedance is Z = (4095/E - 1) * 10 kOhm in counts E (SynTouch manual). A share S of
the untouched Z is the film of fluid between electrode and skin. Its resistance is proportional to 1 / h,
where h is its thickness. What remains is the path to the reference electrode: Z/Z0 = (1 - S) + S h0/h.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from taxel.channels import COUNTS_MAX
from taxel_models.twin.lag import lagged
from taxel_models.twin.sensor import Sensor
from taxel_models.twin.skin import Skin

SERIES_KOHM: Final = 10.0
"""The resistor in series with each electrode (SynTouch manual)."""

FILM_SHARE: Final = 0.85
"""S. Fitted to the counts of strongly pressed electrodes in the LASA recordings."""

THINNEST: Final = 0.18
"""Least thickness of the film over the untouched one: texture on the skin's inside. Fitted, as S."""

DENT_MM: Final = 2.6
"""Radius of the dent of a light touch (one standard deviation of a Gaussian dent). Assumption."""

FREE_AREA_MM2: Final = 190.0
"""Area of skin over which displaced fluid would bulge evenly. Fitted to LASA's rising electrodes."""

SLIDE_MM_PER_N: Final = 0.06
"""How far the skin slides as a shell, mm for 1 N of shear. Assumption."""

FREEDOM: Final = {"side": 1.0, "oblique": 0.45, "underside": 0.35, "tip": 0.6}
"""How freely the skin bulges over a row of electrodes. Read from LASA's rising electrodes."""

_ROW: Final = {
    "side": (1, 4, 6, 11, 14, 16),
    "oblique": (2, 3, 5, 12, 13, 15),
    "underside": (17, 18, 19),
    "tip": (7, 8, 9, 10),
}

POCKET_SHARE: Final = 0.58
POCKET_S: Final = 0.4
POCKET_SPREAD: Final = 0.22
"""There is more fluid under the tip. This share of its film's change comes late, with this time constant,
and the size of the change differs between contacts (SD). Fitted to the paper, where the errors of e7 to
e10 are the highest, and to LASA's pressed electrodes."""


def freedom() -> NDArray[np.float64]:
    """(19,), how freely the skin bulges over each electrode, 0 to 1."""
    by_number = {number: FREEDOM[row] for row, numbers in _ROW.items() for number in numbers}
    return np.array([by_number[number] for number in range(1, 20)])


def thickness(
    sensor: Sensor,
    skin: Skin,
    squared_distances: NDArray[np.float64],
    normal: NDArray[np.float64],
    dented: NDArray[np.float64],
    shear: NDArray[np.float64],
) -> NDArray[np.float64]:
    """The film's thickness over its untouched thickness, (n, 19).

    Three causes add up along each electrode's normal: the dent, the fluid it displaces, which lifts
    the skin away from the dent, and the shell of skin that shear slides sideways.

    Args:
        sensor: where the electrodes are.
        skin: what is above them.
        squared_distances: (n, 19), from the contact to the skin above each electrode, mm².
        normal: (n, 3), out of the skin at the contact.
        dented: (n,), how deep the skin's inner side is dented, mm.
        shear: (n, 3), tangential force on the skin, N.
    """
    variance = DENT_MM**2 + sensor.indenter_radius * dented
    shape = np.exp(-squared_distances / (2.0 * variance[:, None]))
    facing = np.maximum(normal @ sensor.normals.T, 0.0)
    thinning = dented[:, None] * shape * facing
    volume = 2.0 * np.pi * variance * dented
    bulge = (volume / FREE_AREA_MM2)[:, None] * (1.0 - shape) * freedom()
    slide = SLIDE_MM_PER_N * (shear @ sensor.normals.T)
    return np.asarray(np.maximum(1.0 + (bulge + slide - thinning) / skin.fluid, THINNEST))


def pocketed(film: NDArray[np.float64], reach: NDArray[np.float64]) -> NDArray[np.float64]:
    """The film (n, 19) with the pocket under the tip. It fills and drains late, each time differently.

    Args:
        film: thickness over untouched thickness, (n, 19), without the pocket.
        reach: (n,), the size of its change relative to the usual one; constant during one contact.
    """
    changed = film.copy()
    for number in _ROW["tip"]:
        over = np.maximum(1.0 + reach * (film[:, number - 1] - 1.0), THINNEST)
        changed[:, number - 1] = over + POCKET_SHARE * (lagged(over, POCKET_S) - over)
    return changed


def log_impedance(counts: NDArray[np.float64]) -> NDArray[np.float64]:
    """Natural logarithm of the impedance in kOhm, of an electrode's counts."""
    return np.asarray(np.log((COUNTS_MAX / counts - 1.0) * SERIES_KOHM))


def counts_of(log_kohm: NDArray[np.float64]) -> NDArray[np.float64]:
    """An electrode's counts, of the natural logarithm of its impedance in kOhm."""
    return np.asarray(COUNTS_MAX / (1.0 + np.exp(log_kohm) / SERIES_KOHM))


def film_log_ratio(relative_thickness: NDArray[np.float64]) -> NDArray[np.float64]:
    """Natural logarithm of impedance over untouched impedance, of the film's relative thickness."""
    return np.asarray(np.log((1.0 - FILM_SHARE) + FILM_SHARE / relative_thickness))
