"""A calibration that ages: what it told is worth less as time goes on."""

from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from taxel.corrections.calibration import CALIBRATION_AGE, CALIBRATION_EXTRAS
from taxel.corrections.term import BaseTerm, Columns
from taxel.parts import PerChannel, Positive


class Fading(BaseTerm):
    """delta_c = weights[c] calibration_c exp(-calibration_age / time_constant_s).

    Attributes:
        weights: how much of its calibrated offset a channel shows right after the calibration, beyond
            what stays.
        time_constant_s: of the fading.
    """

    kind: Literal["fading"] = "fading"
    weights: PerChannel
    time_constant_s: Positive

    @property
    @override
    def takes(self) -> tuple[str, ...]:
        return (*(extra.name for extra in CALIBRATION_EXTRAS), CALIBRATION_AGE.name)

    @override
    def delta(self, p: NDArray[np.float64], columns: Columns) -> NDArray[np.float64]:
        offsets = np.array([columns[extra.name] for extra in CALIBRATION_EXTRAS]).T
        # An age below 0 is one that no clock gives; it must not make an offset grow.
        age = np.maximum(columns[CALIBRATION_AGE.name], 0.0)
        return np.asarray(self._weights * offsets * np.exp(-age / self.time_constant_s)[:, None])

    @cached_property
    def _weights(self) -> NDArray[np.float64]:
        return np.array(self.weights)
