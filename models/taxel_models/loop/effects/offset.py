"""Offset: a channel's resting value differs."""

from collections.abc import Iterable
from typing import Final

import numpy as np
from typing_extensions import override

from taxel.channels import CHANNELS
from taxel.corrections import CALIBRATION_EXTRAS, Weighted
from taxel_models.loop.basis import Floats, Own
from taxel_models.loop.effects.effect import Candidate, Driver, Effect, Left, Online, weighted
from taxel_models.loop.evidence import Evidence
from taxel_models.loop.planting import Planting

ONE: Final = "one"


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

        if evidence.calibration is not None:
            yield self._calibrated(evidence.calibration)

    def _calibrated(self, offsets: Floats) -> Candidate:
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
            again=lambda _: self._calibrated(offsets),
        )

    @override
    def plant(self, planting: Planting) -> None:
        values = planting.random.normal(size=len(CHANNELS))
        planting.add(np.broadcast_to(values, planting.recording.channels.shape), {"offset": values})
