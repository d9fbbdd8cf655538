"""The noise floor: the part of a residual that no effect can explain.

White noise cannot be predicted. Its variance follows from second differences of the residual, since slow
causes hardly change these: Var(r[t-1] - 2 r[t] + r[t+1]) = 6 sigma². Rows in free air give a second
estimate: the scatter of the measurement about its local mean.
"""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from taxel.channels import CHANNELS
from taxel.windows.history import TOUCH_N
from taxel_models.loop.observations import Observations

_NORMAL_MAD: Final = 1.4826
"""Standard deviation of a normal distribution over its median absolute deviation."""


@dataclass(frozen=True)
class NoiseFloor:
    """Noise of each channel, counts.

    Attributes:
        differences: (21,) SD read off second differences of the residual.
        resting: (21,) SD of the measurement in free air, or None where there are too few such rows.
    """

    differences: NDArray[np.float64]
    resting: NDArray[np.float64] | None

    @classmethod
    def of(cls, observations: Observations, waves: NDArray[np.float64] | float = 0.0) -> "NoiseFloor":
        """Both estimates of a recording.

        Args:
            observations: the recording's rows.
            waves: (n, 21) interference, counts. It is fast, but can be explained.
        """
        inside = observations.segment[2:] == observations.segment[:-2]
        residual = observations.residual - waves
        found = _robust_sd(_second(residual)[inside])
        free = observations.pressed < TOUCH_N
        quiet = inside & free[2:] & free[1:-1] & free[:-2]
        resting = _robust_sd(_second(observations.measured - waves)[quiet]) if quiet.sum() >= 200 else None
        return cls(found, resting)

    def share(self, energy: NDArray[np.float64]) -> NDArray[np.float64]:
        """(21,) part of a mean squared residual (21,), counts², that is noise."""
        return np.minimum(1.0, self.differences**2 / np.maximum(energy, 1e-12))

    def report(self, energy: NDArray[np.float64], output_std: NDArray[np.float64]) -> dict[str, Any]:
        """The error that remains if everything but noise is explained, for `report.json`."""
        mae = self.differences * np.sqrt(2 / np.pi)
        resting = [None] * len(CHANNELS) if self.resting is None else self.resting.tolist()
        return {
            "method": "second differences of the residual; the noise is taken as normal",
            "mae": float(mae.mean()),
            "norm_mae": float((mae / output_std).mean()),
            "share_of_residual_energy": float(self.share(energy).mean()),
            "per_channel": {
                name: {"sd": sd, "sd_resting": at_rest}
                for name, sd, at_rest in zip(CHANNELS, self.differences.tolist(), resting, strict=True)
            },
        }


def _second(values: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(values[2:] - 2 * values[1:-1] + values[:-2])


def _robust_sd(differences: NDArray[np.float64]) -> NDArray[np.float64]:
    """Robust SD of the noise under second differences; at least that of rounding to whole counts."""
    if not len(differences):
        return np.zeros(len(CHANNELS))
    robust = _NORMAL_MAD * np.median(np.abs(differences), axis=0) / np.sqrt(6)
    return np.asarray(np.maximum(robust, 1 / np.sqrt(12)))
