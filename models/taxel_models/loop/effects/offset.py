"""Offset: a channel's resting counts differ from the model's, always or for one contact."""

from collections.abc import Iterable
from typing import Final

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from taxel.channels import CHANNELS
from taxel.corrections import CALIBRATION_AGE, CALIBRATION_EXTRAS, ONE, Calibrated, Weighted
from taxel_models.loop.basis import Basis, Floats, Joined, Own, Shared
from taxel_models.loop.effects.drivers import Driver, weighted
from taxel_models.loop.effects.effect import Candidate, Effect, Fitting, Online, Remaining
from taxel_models.loop.observations import Observations, TakenCalibration

FADING_S: Final = (0.5, 1.0, 2.0, 4.0)
"""Time constants of the fading of a calibration."""

USUAL: Final = 3.0
"""The largest offset that counts for other channels, over the channel's usual offset between contacts."""

ENOUGH_CONTACTS: Final = 4 * (2 + len(CHANNELS))
"""Four for each weight of a channel. With fewer, other channels' offsets explain only chance."""

MEDIAN_OF_SD: Final = 0.6745
"""The median size of a normal deviate over its SD."""

OTHERS: Final = 0.1
"""The prior size of the weights of other channels' offsets: they are many, and they are alike."""


class Offset(Effect):
    """measured = model + b. A channel's b is a constant, or a calibration gives it for each contact."""

    name = "offset"
    is_constant = True
    is_steady = True
    equation = (
        "delta_c = b_c; after a calibration o: (k_c + f_c exp(-t/T)) o_c + sum over j of m_jc clip(o_j)"
    )
    source = "definition; resting counts differ between sensors and after refilling (SynTouch manual)"
    signature = "the residual's mean, the same in free air and in contact, whenever and wherever"

    @override
    def forms(self, observations: Observations, remaining: Remaining) -> Iterable[Candidate]:
        constant = Driver(ONE, np.ones(len(observations)))
        yield weighted(
            observations,
            self.name,
            "constant",
            "unit",
            [constant],
            centred=False,
            weight_names=("offset",),
            weight_units=("counts",),
            mean_absorbed=False,
        )

        if observations.calibration is not None:
            yield from self._calibrated(observations.calibration, observations.segment, remaining.fit)

    def _calibrated(
        self, taken: TakenCalibration, segment: NDArray[np.int64], fit: NDArray[np.bool_]
    ) -> Iterable[Candidate]:
        yield self._staying(taken.offsets)
        for time_constant_s in FADING_S:
            yield self._fading(taken, time_constant_s, None)
        if len(np.unique(segment[fit])) >= ENOUGH_CONTACTS:
            limits = USUAL * np.median(np.abs(taken.offsets[fit]), axis=0) / MEDIAN_OF_SD
            for time_constant_s in FADING_S:
                yield self._fading(taken, time_constant_s, limits)

    def _staying(self, offsets: Floats) -> Candidate:
        names = tuple(extra.name for extra in CALIBRATION_EXTRAS)

        def online(weights: Floats) -> Online:
            term = Weighted(
                shape="unit",
                features=names,
                references=(0.0,) * len(names),
                weights=tuple(tuple(row) for row in np.diag(weights[:, 0]).tolist()),
            )
            return Online((term,), CALIBRATION_EXTRAS)

        return Candidate(
            self.name,
            "of each contact, from a calibration",
            Own(offsets[:, :, None].astype(np.float32)),
            weight_names=("share of the calibrated offset",),
            weight_units=("relative",),
            online=online,
            mean_absorbed=False,
            again=lambda _: self._staying(offsets),
        )

    def _fading(self, taken: TakenCalibration, time_constant_s: float, limits: Floats | None) -> Candidate:
        """The fading offsets; with limits, also the other channels' offsets, clipped to them."""
        faded = taken.offsets * np.exp(-taken.age_s / time_constant_s)[:, None]
        own = Own(np.stack([taken.offsets, faded], axis=2).astype(np.float32))
        told_by, fitting = "", Fitting()
        basis: Basis = own
        if limits is not None:
            told_by = " of all channels"
            basis = Joined(own, Shared(np.clip(taken.offsets, -limits, limits)))
            fitting = Fitting(prior=np.array([1.0] * 2 + [OTHERS] * len(CHANNELS)))
        return Candidate(
            self.name,
            f"of each contact, from a calibration{told_by}, fading with {time_constant_s:g} s",
            basis,
            fitting=fitting,
            weight_names=("share that stays", "share that fades"),
            weight_units=("relative",),
            form_parameters={"time constant of fading": (time_constant_s, "s")},
            online=lambda weights: _fading_online(weights, time_constant_s, limits),
            mean_absorbed=False,
            again=lambda _: self._fading(taken, time_constant_s, limits),
        )


def _fading_online(weights: Floats, time_constant_s: float, limits: Floats | None) -> Online:
    """The online form of weights (21, 2), or (21, 23) if the other channels' offsets count."""
    others = np.zeros((len(CHANNELS), len(CHANNELS))) if limits is None else weights[:, 2:].T
    term = Calibrated(
        stays=tuple(weights[:, 0].tolist()),
        fades=tuple(weights[:, 1].tolist()),
        time_constant_s=time_constant_s,
        others=tuple(tuple(row) for row in others.tolist()),
        limits=(0.0,) * len(CHANNELS) if limits is None else tuple(limits.tolist()),
    )
    return Online((term,), (*CALIBRATION_EXTRAS, CALIBRATION_AGE))
