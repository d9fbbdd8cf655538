"""The fluid's pressure: its slow channel pdc and its fast channels pac0 and pac1, in counts."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from taxel_models.twin.lag import lagged

COUNTS_PER_N: Final = 450.0
"""pdc for 1 N that the fluid carries. Fitted: about +670 counts at strong contacts (measured BioTacs)."""

COUNTS_PER_KELVIN: Final = 1.5
"""pdc follows temperature a little (SynTouch manual); the figure is an assumption."""

RELAXED_SHARE: Final = 0.06
RELAXATION_S: Final = 1.0
"""After a 41 s press a measured pdc undershot by 29 counts and recovered within seconds."""

FAST_GAIN: Final = 36.5 / 0.37
"""pac counts for one pdc count: Pa for a count of each (SynTouch manual)."""

FAST_CORNER_S: Final = 1.0 / (2.0 * np.pi * 10.0)
"""The lower corner of pac's band, 10 Hz (SynTouch manual)."""

RUBBING: Final = 2.4
"""pac counts (SD) of a slide of 1 mm/s under 1 N. Assumption."""

SHAKING: Final = 22.0
"""pac counts (SD) of a press of 1 N by a hand: hands tremble at 8 to 12 Hz. Fitted to the paper's errors of
pac0; taken as white."""

CARRIED_SPREAD: Final = 0.18
"""Variation of the fluid's share of the load between contacts (SD). Fitted to the paper's errors
of pdc."""


def static_counts(fluid_force_n: NDArray[np.float64], warmer_k: NDArray[np.float64]) -> NDArray[np.float64]:
    """The pressure pdc above rest (n,): the fluid's relaxing load, and a small effect of temperature."""
    load = COUNTS_PER_N * fluid_force_n
    return np.asarray(load - RELAXED_SHARE * lagged(load, RELAXATION_S) + COUNTS_PER_KELVIN * warmer_k)


def vibration_counts(
    static: NDArray[np.float64],
    rubbing: NDArray[np.float64],
    press: NDArray[np.float64],
    noise: np.random.Generator,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """pac0 and pac1 about rest, each (n,): pdc above 10 Hz, vibration of sliding, and tremor.

    Args:
        static: (n,), pdc above rest, counts.
        rubbing: (n,), the square root of sliding speed (mm/s) times normal force (N).
        press: (n,), normal force, N.
        noise: for sliding and tremor, which count as white in this band.
    """
    fast = FAST_GAIN * (static - lagged(static, FAST_CORNER_S))
    half_a_row_later = 0.5 * (fast + np.append(fast[1:], fast[-1]))
    scratch = np.hypot(RUBBING * rubbing, SHAKING * press)[:, None] * noise.standard_normal(
        (len(static), 2)
    )
    return fast + scratch[:, 0], half_a_row_later + scratch[:, 1]
