"""A sensor whose counts are tared, as slide recordings have them: each says how far it is from rest."""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from taxel.channels import COUNTS_MAX
from taxel_models.recordings import Recording

Floats = NDArray[np.float64]


class Tared:
    """The smooth model of such a finger; it reads a share of the counts."""

    def __init__(self, smooth: Any, share: float = 1.0) -> None:
        self.manifest, self._smooth, self._share = smooth.manifest, smooth, share
        self._rest = smooth.counts(np.zeros((1, 3)), np.zeros((1, 3)))

    def of_size(self, counts: Floats) -> Floats:
        """What it reads for the smooth model's counts (n, 21)."""
        return np.asarray(np.abs(counts - self._rest) * self._share)

    def predict(self, windows: NDArray[np.float32]) -> NDArray[np.float32]:
        return self.of_size(self._smooth.predict(windows).astype(np.float64)).astype(np.float32)

    predict_base = predict

    def of(self, recording: Recording) -> Recording:
        """A recording of the smooth model, with the same noise."""
        own = self._smooth.counts(recording.samples.position, recording.samples.force)
        return with_counts(recording, self.of_size(own) + (recording.channels - own))


def with_counts(recording: Recording, counts: Floats) -> Recording:
    """A recording with other counts (n, 21): whole ones, from 0 to 4095."""
    return replace(recording, channels=np.clip(np.rint(counts), 0, COUNTS_MAX))
