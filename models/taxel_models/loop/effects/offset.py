"""Offset: a channel's resting value differs."""

from collections.abc import Iterable
from typing import Final

import numpy as np
from typing_extensions import override

from taxel.channels import CHANNELS
from taxel.corrections import CALIBRATION_AGE, CALIBRATION_EXTRAS, Fading, Weighted
from taxel_models.loop.basis import Floats, Own
from taxel_models.loop.effects.effect import Candidate, Driver, Effect, Left, Online, weighted
from taxel_models.loop.evidence import Evidence
from taxel_models.loop.planting import Planting

ONE: Final = "one"

FADING_S: Final = (0.5, 1.0, 2.0, 4.0)
"""Time constants that are tried for what a calibration tells for a while only."""


class Offset(Effect):
    """measured = model + b, a constant of each channel."""

    name = "offset"
    equation = "delta_c = b_c"
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
            yield self._calibrated(evidence.calibration)
            for time_constant_s in FADING_S:
                yield self._fading(evidence.calibration, evidence.calibration_age, time_constant_s)

    def _calibrated(self, offsets: Floats) -> Candidate:
        def online(weights: Floats) -> Online:
            return Online((_staying(weights[:, 0]),), CALIBRATION_EXTRAS)

        return Candidate(
            self.name,
            "of each contact, from a calibration",
            Own(offsets[:, :, None].astype(np.float32)),
            weight_names=("share of the calibrated offset",),
            weight_unit="relative",
            online=online,
            again=lambda _: self._calibrated(offsets),
        )

    def _fading(self, offsets: Floats, age: Floats, time_constant_s: float) -> Candidate:
        def online(weights: Floats) -> Online:
            fading = Fading(weights=tuple(weights[:, 1].tolist()), time_constant_s=time_constant_s)
            return Online((_staying(weights[:, 0]), fading), (*CALIBRATION_EXTRAS, CALIBRATION_AGE))

        faded = offsets * np.exp(-age / time_constant_s)[:, None]
        return Candidate(
            self.name,
            f"of each contact, from a calibration, fading with {time_constant_s:g} s",
            Own(np.stack([offsets, faded], axis=2).astype(np.float32)),
            weight_names=("share that stays", "share that fades"),
            weight_unit="relative",
            settled={"time constant of fading": (time_constant_s, "s")},
            online=online,
            again=lambda _: self._fading(offsets, age, time_constant_s),
        )

    @override
    def plant(self, planting: Planting) -> None:
        values = planting.random.normal(size=len(CHANNELS))
        planting.add(np.broadcast_to(values, planting.recording.channels.shape), {"offset": values})


def _staying(shares: Floats) -> Weighted:
    """A share (21,) of each channel's own calibrated offset."""
    names = tuple(extra.name for extra in CALIBRATION_EXTRAS)
    return Weighted(
        shape="unit",
        features=names,
        references=(0.0,) * len(names),
        weights=tuple(tuple(row) for row in np.diag(shares).tolist()),
    )
