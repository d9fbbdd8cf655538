"""The 21 output channels of a BioTac 2P fingertip, in the one order used everywhere."""

from typing import Final

ELECTRODES: Final = tuple(f"e{number}" for number in range(1, 20))
"""The 19 impedance electrodes."""

CHANNELS: Final = ("pac0", "pdc", *ELECTRODES)
"""Vibration, static pressure, then the electrodes: the columns of every prediction."""

ELECTRODE_COLUMNS: Final = slice(2, len(CHANNELS))
"""The positions of the electrodes in `CHANNELS`."""

COUNTS_MAX: Final = 4095
"""Largest value of the sensor's 12-bit converter, in counts."""
