"""The sensor's converter: one channel after another, noise, and 12 bits."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from taxel.channels import COUNTS_MAX

SLOTS: Final = 44
"""In one 10 ms frame: a vibration sample before every other channel (SynTouch manual)."""

ELECTRODE_NOISE: Final = (0.45, 4.0)
"""Least and greatest SD of an electrode at rest, counts (measured BioTacs)."""

NOISE: Final = {"pac": 4.8, "pdc": 0.4, "tac": 1.0, "tdc": 0.3}
"""SD at rest, counts: pac and pdc as measured BioTacs, tac and tdc assumptions."""


def one_after_another(electrodes: NDArray[np.float64]) -> NDArray[np.float64]:
    """Read 19 electrodes in turn within each frame: (n + 1, 19) to (n, 19).

    The last electrode is read some 8 ms after the row's time.
    """
    delay = 2.0 * np.arange(electrodes.shape[1]) / SLOTS
    return np.asarray(electrodes[:-1] + delay * np.diff(electrodes, axis=0))


def electrode_noise(count: int, dice: np.random.Generator) -> NDArray[np.float64]:
    """An SD for each electrode, counts, log-uniform between the measured extremes."""
    low, high = ELECTRODE_NOISE
    return np.asarray(low * (high / low) ** dice.random(count))


def convert(
    counts: NDArray[np.float64], noise_sd: NDArray[np.float64] | float, noise: np.random.Generator
) -> NDArray[np.float64]:
    """What the converter gives for ideal counts of any shape: whole numbers in 0..4095."""
    noisy = counts + noise_sd * noise.standard_normal(counts.shape)
    return np.clip(np.rint(noisy), 0, COUNTS_MAX)
