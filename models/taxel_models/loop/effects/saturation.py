"""Saturation: beyond a level, a channel answers less than the model expects."""

from collections.abc import Iterable
from functools import partial
from typing import Final

import numpy as np
from typing_extensions import override

from taxel.channels import CHANNELS
from taxel.corrections import Limit
from taxel_models.loop.basis import Floats, Own
from taxel_models.loop.effects.effect import Candidate, Effect, Left, Online
from taxel_models.loop.evidence import TOUCH_N, Evidence
from taxel_models.loop.moments import Fitting
from taxel_models.loop.planting import Planting

QUANTILES: Final = (0.5, 0.65, 0.8, 0.9, 0.95)
"""Of the signal's magnitude while touched: where a level is looked for."""


class Saturation(Effect):
    """The part of the signal beyond a level is cut by a slope; 1 cuts it off."""

    name = "saturation"
    equation = "delta_c = -k_c sign(s_c) max(|s_c| - L_c, 0), s_c = p_c - rest_c"
    source = "skin meets the core near 2 N, the converter's end (SynTouch manual): a bent line"
    signature = "the residual is nil below a level of the signal and grows beyond, against it"

    @override
    def forms(self, evidence: Evidence, left: Left) -> Iterable[Candidate]:
        touched = left.fit & (evidence.pressed > TOUCH_N)
        if not touched.any():
            return
        for quantile in QUANTILES:
            level = np.quantile(np.abs(evidence.signal[touched]), quantile, axis=0)
            for pooled in (True, False):
                yield self._with(quantile, level, pooled, evidence)

    def _with(self, quantile: float, level: Floats, pooled: bool, evidence: Evidence) -> Candidate:
        def online(weights: Floats) -> Online:
            slope = tuple(weights[:, 0].tolist())
            rest = tuple(evidence.rest.tolist())
            return Online((Limit(level=tuple(level.tolist()), slope=slope, rest=rest),))

        return Candidate(
            self.name,
            f"beyond {quantile:.0%} of the signal, {'all channels alike' if pooled else 'by channel'}",
            Own(beyond(evidence.signal, level)[:, :, None].astype(np.float32)),
            fitting=Fitting(pooled=pooled),
            weight_names=("slope",),
            weight_unit="relative",
            settled={"quantile": (quantile, "of |signal|")},
            online=online,
            again=partial(self._with, quantile, level, pooled),
        )

    @override
    def plant(self, planting: Planting) -> None:
        touched = planting.pressed > TOUCH_N
        quantile = float(planting.random.uniform(0.5, 0.85))
        level = np.quantile(np.abs(planting.signal[touched]), quantile, axis=0)
        slope = planting.random.uniform(0.7, 1.3, len(CHANNELS))
        planting.add(beyond(planting.signal, level) * slope, {"slope": slope}, quantile=quantile)


def beyond(signal: Floats, level: Floats) -> Floats:
    """(n, 21) what `Limit` takes away with a slope of 1, as it is added."""
    return np.asarray(-np.sign(signal) * np.maximum(np.abs(signal) - level, 0.0))
