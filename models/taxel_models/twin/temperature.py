"""The fingertip's warm-up, its cooling by the indenter, and the channels tdc and tac."""

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from taxel.channels import COUNTS_MAX
from taxel_models.twin.lag import PERIOD_S, lagged

START_COUNTS: Final = 1850.0
END_COUNTS: Final = 2040.0
MEAN_COUNTS: Final = 1968.75
RECORDED_S: Final = 2922.0
"""tdc's first, last and mean value over the paper's recording of 292,200 rows."""

WARM_UP_S: Final = 1870.0
"""The time constant of the first-order rise from first to last value that has the paper's mean."""

LOG_IMPEDANCE_PER_KELVIN: Final = -0.029
"""Change of ln Z per kelvin, common to all electrodes. Fitted to the error that a fixed temperature adds to
the paper's network; the literature gives about -0.02 for salt water."""

LONGEST_ON_S: Final = 4 * 3600.0
"""A finger that is on for so long no longer warms up."""

COOLING_K: Final = 0.12
COOLING_S: Final = 8.0
"""How far a long contact with the indenter cools the core, and how fast. Assumptions."""

FLOW_CORNER_S: Final = 1.0 / (2.0 * np.pi * 0.35)
"""tac is tdc above a corner of about 0.25 to 0.45 Hz (SynTouch manual)."""

FLOW_GAIN: Final = 40.0
"""tac counts for one tdc count. Fitted: tac rests at its published value while the finger warms up."""


def celsius(tdc: NDArray[np.float64]) -> NDArray[np.float64]:
    """Temperature of tdc counts (SynTouch manual)."""
    x = tdc / COUNTS_MAX
    return np.asarray(4025.0 / np.log((155183.0 - 46555.0 * x) / x) - 273.15)


def tdc_counts(temperature: NDArray[np.float64]) -> NDArray[np.float64]:
    """The counts tdc of a temperature, the inverse of `celsius`."""
    return np.asarray(COUNTS_MAX * 155183.0 / (np.exp(4025.0 / (temperature + 273.15)) + 46555.0))


REFERENCE_C: Final = float(celsius(np.array([MEAN_COUNTS]))[0])
"""The temperature of the resting counts: the recording's mean. Assumption."""


def core_celsius(
    rows: int, touched: NDArray[np.float64], on_for_s: float = 0.0, cooling_k: float = COOLING_K
) -> NDArray[np.float64]:
    """The core's temperature (rows,), °C, warming in real time from the paper's first value.

    Args:
        rows: how many, 10 ms apart.
        touched: (rows,), 0 in free air to 1 in full contact with the colder indenter.
        on_for_s: how long the finger is switched on before the first row.
        cooling_k: how far a long contact cools the core.
    """
    first, last = celsius(np.array([START_COUNTS, END_COUNTS]))
    reached = 1.0 - np.exp(-RECORDED_S / WARM_UP_S)
    elapsed = on_for_s + np.arange(rows) * PERIOD_S
    warming = first + (last - first) / reached * (1.0 - np.exp(-elapsed / WARM_UP_S))
    return np.asarray(warming - cooling_k * lagged(touched, COOLING_S))


def on_for(tdc: float) -> float:
    """How long the twin must be on to read so many tdc counts, s; 0 or four hours where it never does."""
    first, last, wanted = celsius(np.array([START_COUNTS, END_COUNTS, tdc]))
    warmed = (wanted - first) / (last - first) * -np.expm1(-RECORDED_S / WARM_UP_S)
    return float(-WARM_UP_S * np.log1p(-np.clip(warmed, 0.0, -np.expm1(-LONGEST_ON_S / WARM_UP_S))))


def core_celsius_between(
    lengths: Sequence[int],
    gaps: Sequence[Sequence[tuple[bool, float]]],
    touched: NDArray[np.float64],
    on_for_s: float,
    cooling_k: float,
) -> NDArray[np.float64]:
    """The core's temperature (rows,), °C, over stretches of rows with gaps between them.

    A finger that is off cools towards the paper's first value as fast as it warms up (an assumption).

    Args:
        lengths: rows of each stretch, in which the finger is on and which begins untouched.
        gaps: before each stretch but the first: whether the finger is on, and for how long, s, in order.
        touched: (rows,), 0 in free air to 1 in full contact with the colder indenter.
        on_for_s: how long the finger is switched on before the first row.
        cooling_k: how far a long contact cools the core.
    """
    parts, start, warm_s = [], 0, on_for_s
    for length, gap in zip(lengths, [(), *gaps], strict=True):
        for is_on, seconds in gap:
            # As warm as after so many seconds of warming up.
            off = -WARM_UP_S * np.log1p(-np.exp(-seconds / WARM_UP_S) * -np.expm1(-warm_s / WARM_UP_S))
            warm_s = warm_s + seconds if is_on else float(off)
        parts.append(core_celsius(length, touched[start : start + length], warm_s, cooling_k))
        start, warm_s = start + length, warm_s + length * PERIOD_S
    return np.concatenate(parts)


def flow_counts(tdc: NDArray[np.float64]) -> NDArray[np.float64]:
    """The heat flow tac about rest (n,): the fast component of the temperature."""
    return np.asarray(FLOW_GAIN * (tdc - lagged(tdc, FLOW_CORNER_S)))
