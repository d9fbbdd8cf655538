"""Saturation: above a level, a channel responds less than the model predicts."""

from collections.abc import Iterable
from functools import partial
from typing import Final

import numpy as np
from typing_extensions import override

from taxel.corrections import Saturation as SaturationTerm
from taxel.corrections import saturation_design
from taxel.windows.history import TOUCH_N
from taxel_models.loop.basis import Floats, Own
from taxel_models.loop.effects.effect import Candidate, Effect, Fitting, Online, Remaining
from taxel_models.loop.observations import Observations

QUANTILES: Final = (0.5, 0.65, 0.8, 0.9, 0.95)
"""Quantiles of the signal's magnitude while touched: the levels that are tried."""


class Saturation(Effect):
    """The signal above a level is reduced by a slope; a slope of 1 cuts it off."""

    name = "saturation"
    equation = "delta_c = -k_c sign(s_c) max(|s_c| - L_c, 0), s_c = p_c - rest_c"
    source = "skin meets the core near 2 N, the converter's end (SynTouch manual): a bent line"
    signature = "the residual is zero below a level of the signal and grows beyond, against it"

    @override
    def forms(self, observations: Observations, remaining: Remaining) -> Iterable[Candidate]:
        touched = remaining.fit & (observations.pressed > TOUCH_N)
        if not touched.any():
            return
        for quantile in QUANTILES:
            level = np.quantile(np.abs(observations.signal[touched]), quantile, axis=0)
            for pooled in (True, False):
                yield self._with(quantile, level, pooled, observations)

    def _with(self, quantile: float, level: Floats, pooled: bool, observations: Observations) -> Candidate:
        def online(weights: Floats) -> Online:
            slope = tuple(weights[:, 0].tolist())
            rest = tuple(observations.rest.tolist())
            return Online((SaturationTerm(level=tuple(level.tolist()), slope=slope, rest=rest),))

        return Candidate(
            self.name,
            f"beyond {quantile:.0%} of the signal, {'all channels alike' if pooled else 'by channel'}",
            Own(saturation_design(observations.signal, level)[:, :, None].astype(np.float32)),
            # A slope below 0 would be a channel that responds more, the more it is pressed.
            fitting=Fitting(pooled=pooled, positive=True),
            weight_names=("slope",),
            weight_unit="relative",
            form_parameters={"quantile": (quantile, "of |signal|")},
            online=online,
            again=partial(self._with, quantile, level, pooled),
        )
