"""The columns of the plugin's networks, and the positions of the served ones.

The plugin's networks are trained with the order T, T+10, T-10. The plugin's serving code fills T, T-10,
T+10, which swaps past and future. Here, columns have names and are found by name.
"""

from typing import Final

from taxel.channels import CHANNELS, ELECTRODES
from taxel.windows import WindowSpec

SPEC: Final = WindowSpec.of(1)
"""The window for these networks."""

TEMPERATURE: Final = "tdc"

INPUTS: Final = (
    *("x", "y", "z"),
    *("fx", "fy", "fz"),
    *("fx[+10]", "fy[+10]", "fz[+10]"),
    *("fx[-10]", "fy[-10]", "fz[-10]"),
    TEMPERATURE,
)
"""The inputs of a network, in the order of its training."""

OUTPUTS: Final = ("pac0", "pac1", "pdc", "tac", *ELECTRODES)
"""The outputs of a network; the plugin counts electrodes from 0."""

FEATURES: Final = (*SPEC.features, TEMPERATURE)
"""The inputs of the served model, in our order."""

FEATURE_COLUMNS: Final = tuple(INPUTS.index(name) for name in FEATURES)
"""The position of each of our features in `INPUTS`."""

INPUT_COLUMNS: Final = tuple(FEATURES.index(name) for name in INPUTS)
"""The position of each of `INPUTS` in our features."""

CHANNEL_COLUMNS: Final = tuple(OUTPUTS.index(name) for name in CHANNELS)
"""The position of each of our channels in `OUTPUTS`."""
