"""Offset: a channel's resting value differs, always or for one contact."""

from collections.abc import Iterable
from typing import Final

import numpy as np
from typing_extensions import override

from taxel.channels import CHANNELS
from taxel.corrections import CALIBRATION_AGE, CALIBRATION_EXTRAS, Calibrated, Weighted
from taxel_models.loop.basis import Floats, Joined, Own, Shared
from taxel_models.loop.effects.effect import Candidate, Driver, Effect, Left, Online, weighted
from taxel_models.loop.evidence import Evidence
from taxel_models.loop.moments import Fitting
from taxel_models.loop.planting import Planting

ONE: Final = "one"

FADING_S: Final = (0.5, 1.0, 2.0, 4.0)
"""Time constants that are tried for what a calibration tells for a while only."""

USUAL: Final = 3.0
"""Times a channel's usual offset between contacts: beyond, it does not count for other channels."""

ENOUGH_CONTACTS: Final = 4 * (2 + len(CHANNELS))
"""Four for each figure of a channel: with fewer, what other channels tell cannot be told from chance."""

MEDIAN_OF_SD: Final = 0.6745
"""The median size of a normal deviate over its SD."""

OWN_RIDGE: Final = 0.01
OTHERS_RIDGE: Final = 0.3
"""How far a channel's own offset and the others' are held back: the others' are many and much alike."""


class Offset(Effect):
    """measured = model + b, a constant of each channel, or what a calibration tells of each contact."""

    name = "offset"
    equation = (
        "delta_c = b_c; after a calibration o: (k_c + f_c exp(-t/T)) o_c + sum over j of m_jc clip(o_j)"
    )
    source = "definition; resting counts differ between sensors and after refilling (SynTouch manual)"
    signature = "the residual's mean, the same in free air and in contact, whenever and wherever"

    @override
    def forms(self, evidence: Evidence, left: Left) -> Iterable[Candidate]:
        one = Driver(ONE, np.ones(len(evidence)))
        yield weighted(
            evidence,
            self.name,
            "constant",
            "unit",
            [one],
            centred=False,
            weight_names=("offset",),
            weight_unit="counts",
        )

        if evidence.calibration is not None and evidence.calibration_age is not None:
            offsets, age = evidence.calibration, evidence.calibration_age
            limits = USUAL * np.median(np.abs(offsets[left.fit]), axis=0) / MEDIAN_OF_SD
            yield self._staying(offsets)
            many = len(np.unique(evidence.segment[left.fit])) >= ENOUGH_CONTACTS
            for time_constant_s in FADING_S:
                yield self._fading(offsets, age, time_constant_s)
                if many:
                    yield self._together(offsets, age, time_constant_s, limits)

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
            weight_unit="relative",
            online=online,
            again=lambda _: self._staying(offsets),
        )

    def _fading(self, offsets: Floats, age: Floats, time_constant_s: float) -> Candidate:
        nothing = np.zeros(len(CHANNELS))
        return Candidate(
            self.name,
            f"of each contact, from a calibration, fading with {time_constant_s:g} s",
            _own(offsets, age, time_constant_s),
            weight_names=("share that stays", "share that fades"),
            weight_unit="relative",
            settled={"time constant of fading": (time_constant_s, "s")},
            online=lambda weights: _calibrated(weights, time_constant_s, nothing),
            again=lambda _: self._fading(offsets, age, time_constant_s),
        )

    def _together(self, offsets: Floats, age: Floats, time_constant_s: float, limits: Floats) -> Candidate:
        others = Shared(np.clip(offsets, -limits, limits))
        return Candidate(
            self.name,
            f"of each contact, from a calibration of all channels, fading with {time_constant_s:g} s",
            Joined(_own(offsets, age, time_constant_s), others),
            fitting=Fitting(ridge=np.array([OWN_RIDGE] * 2 + [OTHERS_RIDGE] * len(CHANNELS))),
            weight_names=("share that stays", "share that fades"),
            weight_unit="relative",
            settled={"time constant of fading": (time_constant_s, "s")},
            online=lambda weights: _calibrated(weights, time_constant_s, limits),
            again=lambda _: self._together(offsets, age, time_constant_s, limits),
        )

    @override
    def plant(self, planting: Planting) -> None:
        values = planting.random.normal(size=len(CHANNELS))
        planting.add(np.broadcast_to(values, planting.recording.channels.shape), {"offset": values})


def _own(offsets: Floats, age: Floats, time_constant_s: float) -> Own:
    """Each channel's own offset, and the same fading."""
    faded = offsets * np.exp(-age / time_constant_s)[:, None]
    return Own(np.stack([offsets, faded], axis=2).astype(np.float32))


def _calibrated(weights: Floats, time_constant_s: float, limits: Floats) -> Online:
    """Of weights (21, 2), or (21, 23) where other channels' offsets count."""
    others = weights[:, 2:].T if weights.shape[1] > 2 else np.zeros((len(CHANNELS),) * 2)
    term = Calibrated(
        stays=tuple(weights[:, 0].tolist()),
        fades=tuple(weights[:, 1].tolist()),
        time_constant_s=time_constant_s,
        others=tuple(tuple(row) for row in others.tolist()),
        limits=tuple(limits.tolist()),
    )
    return Online((term,), (*CALIBRATION_EXTRAS, CALIBRATION_AGE))
