"""What a calibration told: offsets of each channel, worth less as time goes on."""

from functools import cached_property
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from typing_extensions import override

from taxel.channels import CHANNELS
from taxel.corrections.calibration import CALIBRATION_AGE, CALIBRATION_EXTRAS
from taxel.corrections.term import BaseTerm, Columns
from taxel.schema import NotNegative, PerChannel, Positive


class Calibrated(BaseTerm):
    """`delta_c = (stays[c] + fades[c] exp(-age / time_constant_s)) o_c + Σ_j others[j][c] clip(o_j)`.

    o are the calibrated offsets, counts; clip(o_j) keeps o_j within limits[j] of 0, so that one contact
    that is far from all others does not move every channel.

    Attributes:
        stays: the share of its own offset that a channel keeps.
        fades: the share that it shows right after the calibration, beyond what stays.
        time_constant_s: of the fading.
        others: what each channel's offset tells of every channel, by source.
        limits: the largest offset of each channel that counts for others, counts.
    """

    kind: Literal["calibrated"] = "calibrated"
    stays: PerChannel
    fades: PerChannel
    time_constant_s: Positive
    others: Annotated[tuple[PerChannel, ...], Field(min_length=len(CHANNELS), max_length=len(CHANNELS))]
    limits: Annotated[tuple[NotNegative, ...], Field(min_length=len(CHANNELS), max_length=len(CHANNELS))]

    @property
    @override
    def takes(self) -> tuple[str, ...]:
        return (*(extra.name for extra in CALIBRATION_EXTRAS), CALIBRATION_AGE.name)

    @override
    def delta(self, p: NDArray[np.float64], columns: Columns) -> NDArray[np.float64]:
        stays, fades, others, limits = self._arrays
        offsets = np.array([columns[extra.name] for extra in CALIBRATION_EXTRAS]).T
        # An age below 0 is one that no clock gives; it must not make an offset grow.
        age = np.maximum(columns[CALIBRATION_AGE.name], 0.0)
        shares = stays + fades * np.exp(-age / self.time_constant_s)[:, None]
        return np.asarray(shares * offsets + np.clip(offsets, -limits, limits) @ others)

    @cached_property
    def _arrays(self) -> tuple[NDArray[np.float64], ...]:
        return tuple(np.array(values) for values in (self.stays, self.fades, self.others, self.limits))
