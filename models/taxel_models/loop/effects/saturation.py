"""Saturation: above a level, a channel responds less than the model predicts."""

from collections.abc import Iterable
from dataclasses import replace
from functools import partial
from typing import Final

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from taxel.channels import CHANNELS
from taxel.corrections import Saturation as SaturationTerm
from taxel.corrections import saturation_design
from taxel.windows.history import TOUCH_N
from taxel_models.loop.basis import Floats, Own
from taxel_models.loop.effects.effect import SHARED_WEIGHTS, Candidate, Effect, Fitting, Online, Remaining
from taxel_models.loop.observations import Observations

QUANTILES: Final = (0.35, 0.5, 0.65, 0.8, 0.9, 0.95)
"""Quantiles of the signal's magnitude while touched: the levels that are tried.

One channel that bends at a lower level could as well have lost sensitivity.
"""

SHARED_FROM: Final = 0.5
"""The lowest quantile that is tried for channels that are alike."""


class Saturation(Effect):
    """The signal above a level is reduced by a slope; a slope of 1 cuts it off."""

    name = "saturation"
    looks_at_residual = True
    is_of_one_channel = True
    equation = "delta_c = -k_c sign(s_c) max(|s_c| - L_c, 0), s_c = p_c - rest_c"
    source = "skin meets the core near 2 N, the converter's end (SynTouch manual): a bent line"
    signature = "the residual is zero below a level of the signal and grows beyond, against it"

    @override
    def forms(self, observations: Observations, remaining: Remaining) -> Iterable[Candidate]:
        levels = levels_of(observations, remaining.fit)
        if not len(levels):
            return
        for quantile, level in zip(QUANTILES, levels, strict=True):
            if quantile >= SHARED_FROM:
                for alike, fitting in SHARED_WEIGHTS.items():
                    yield self._with(
                        f"beyond {quantile:.0%} of the signal, {alike}", level, fitting, observations
                    )
        chosen = _best_levels(levels, observations, remaining)
        own = Fitting(choices=len(QUANTILES))
        yield self._with("beyond each channel's own level", chosen, own, observations)

    def _with(self, form: str, level: Floats, fitting: Fitting, observations: Observations) -> Candidate:
        def online(weights: Floats) -> Online:
            slope = tuple(weights[:, 0].tolist())
            rest = tuple(observations.rest.tolist())
            return Online((SaturationTerm(level=tuple(level.tolist()), slope=slope, rest=rest),))

        return Candidate(
            self.name,
            form,
            Own(saturation_design(observations.signal, level)[:, :, None].astype(np.float32)),
            # A slope below 0 would be a channel that responds more, the more it is pressed.
            fitting=replace(fitting, positive=True),
            weight_names=("slope",),
            weight_units=("relative",),
            online=online,
            again=partial(self._with, form, level, fitting),
        )


def levels_of(observations: Observations, fit: NDArray[np.bool_]) -> Floats:
    """(k, 21) levels that are tried, counts from rest; none where nothing is touched.

    Args:
        fit: (n,) rows that tell.
    """
    touched = fit & (observations.pressed > TOUCH_N)
    if not touched.any():
        return np.empty((0, len(CHANNELS)))
    return np.quantile(np.abs(observations.signal[touched]), QUANTILES, axis=0)


def _best_levels(levels: Floats, observations: Observations, remaining: Remaining) -> Floats:
    """(21,) of the levels (k, 21) the one beyond which each channel's residual bends most."""
    weight = remaining.row_weights[remaining.fit][:, None]
    signal, residual = observations.signal[remaining.fit], remaining.residual[remaining.fit]
    explained = []
    for level in levels:
        design = saturation_design(signal, level)
        design = design - (weight * design).sum(axis=0) / weight.sum()
        cross, energy = (weight * design * residual).sum(axis=0), (weight * design**2).sum(axis=0)
        explained.append(np.maximum(cross, 0.0) ** 2 / np.maximum(energy, 1e-9))
    best = np.argmax(explained, axis=0)
    return np.asarray(levels[best, np.arange(levels.shape[1])])
