"""The columns of the plugin's networks, and where those that we serve stand among them.

This is the order in which the plugin's networks are trained: T, T+10, T-10. Its own serving code
fills T, T-10, T+10, which swaps past and future; columns here have names, and are found by them.
"""

from typing import Final

from taxel.channels import CHANNELS, ELECTRODES
from taxel.windows import WindowSpec

SPEC: Final = WindowSpec.of(1)
"""The window that holds what these networks take."""

TEMPERATURE: Final = "tdc"

INPUTS: Final = (
    *("x", "y", "z"),
    *("fx", "fy", "fz"),
    *("fx[+10]", "fy[+10]", "fz[+10]"),
    *("fx[-10]", "fy[-10]", "fz[-10]"),
    TEMPERATURE,
)
"""What a network takes, in the order of its training."""

OUTPUTS: Final = ("pac0", "pac1", "pdc", "tac", *ELECTRODES)
"""What a network gives; the plugin counts its electrodes from 0."""

FEATURES: Final = (*SPEC.features, TEMPERATURE)
"""What the served model takes, in our order."""

FEATURE_COLUMNS: Final = tuple(INPUTS.index(name) for name in FEATURES)
"""Where each of our features stands among `INPUTS`."""

INPUT_COLUMNS: Final = tuple(FEATURES.index(name) for name in INPUTS)
"""Where each of `INPUTS` stands among our features."""

CHANNEL_COLUMNS: Final = tuple(OUTPUTS.index(name) for name in CHANNELS)
"""Where each of our channels stands among `OUTPUTS`."""
