"""Random windows to measure a model with."""

import numpy as np
from numpy.random import SeedSequence
from numpy.typing import NDArray

from taxel.manifest import Manifest


def random_windows(manifest: Manifest, rows: int, seed: int | SeedSequence) -> NDArray[np.float32]:
    """Windows drawn from the normal distribution of the model's training inputs, (rows, f).

    Features that only effects take have their defaults.
    """
    statistics = manifest.normalisation
    draws = np.random.default_rng(seed).standard_normal((rows, len(statistics.input_mean)))
    windows = draws * statistics.input_std + statistics.input_mean
    defaults = [extra.default for extra in manifest.window.effect_extras]
    return np.hstack([windows, np.tile(defaults, (rows, 1))]).astype(np.float32)
