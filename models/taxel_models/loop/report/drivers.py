"""What a residual is drawn against: the quantity that an effect depends on."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from taxel.channels import CHANNELS
from taxel.corrections import Crosstalk as CrosstalkTerm
from taxel.windows.history import TICK_S
from taxel_models.loop.basis import AboutMean, Floats, Shared
from taxel_models.loop.effects.covariate import Covariate
from taxel_models.loop.effects.crosstalk import Crosstalk
from taxel_models.loop.effects.drift import Drift
from taxel_models.loop.effects.gain import Gain
from taxel_models.loop.effects.lag import Lag
from taxel_models.loop.effects.saturation import Saturation
from taxel_models.loop.effects.temperature import TDC, WARMING, Temperature
from taxel_models.loop.pipeline import LoopResult
from taxel_models.loop.report.partial import Partial

_CHANGE_TICKS: Final = 5


@dataclass(frozen=True)
class Axis:
    """The horizontal axis of one channel's panel.

    Attributes:
        label: with its unit.
        values: (m,) at the evaluation rows.
    """

    label: str
    values: Floats


def axis_of(result: LoopResult, partial: Partial, channel: int) -> Axis:
    """The effect's driver for a channel; where it has none by itself, what the effect adds."""
    observations, rows, name = result.observations, partial.rows, CHANNELS[channel]
    found: Axis | None
    match partial.kind:
        case Gain.name | Saturation.name:
            found = Axis(f"{name} as predicted, from rest, counts", observations.signal[rows, channel])
        case Temperature.name if WARMING in partial.named.candidate.form_parameters:
            found = _warmth(partial)
        case Temperature.name if TDC in observations.covariates:
            found = Axis(f"{TDC}, counts", observations.covariates[TDC][rows])
        case Drift.name | Temperature.name:
            found = Axis("time since the recording began, s", observations.time_s[rows])
        case Lag.name:
            found = Axis(f"change of {name} as predicted, counts/s", _change(result, channel)[rows])
        case Crosstalk.name:
            found = _source(result, partial, channel)
        case Covariate.name:
            found = _covariate(result, partial)
        case _:
            found = _feature(result, partial)
    contribution = Axis(f"what {partial.named.name} adds, counts", partial.contribution[:, channel])
    return found or contribution


def _shared(partial: Partial) -> Shared | None:
    """Features that are the same for all channels, without the means that are taken out of them."""
    basis = partial.named.candidate.basis
    basis = basis.basis if isinstance(basis, AboutMean) else basis
    return basis if isinstance(basis, Shared) else None


def _warmth(partial: Partial) -> Axis | None:
    basis = _shared(partial)
    label = "how warm contact has made the skin, 0 to 1"
    return None if basis is None else Axis(label, basis.features[partial.rows, 0])


def _feature(result: LoopResult, partial: Partial) -> Axis | None:
    """The one feature that all channels' weights multiply."""
    basis = _shared(partial)
    if basis is None or basis.size > 1 or basis.shape is not None:
        return None
    name = partial.named.candidate.weight_names[0]
    extra = next((extra for extra in result.new.extras if extra.name == name), None)
    unit = f", {extra.unit}" if extra and extra.unit else ""
    about = "" if extra and extra.history else " from its mean"
    return Axis(f"{name}{about}{unit}", basis.features[partial.rows, 0])


def _covariate(result: LoopResult, partial: Partial) -> Axis | None:
    basis = _shared(partial)
    if basis is None or basis.shape is not None:
        return None
    column = partial.named.name.partition(":")[2]
    return Axis(column, result.observations.covariates[column][partial.rows])


def _change(result: LoopResult, channel: int) -> Floats:
    """(n,) counts/s."""
    counts = result.observations.predicted[:, channel]
    earlier = result.observations.rows_before(_CHANGE_TICKS)
    return np.asarray((counts - counts[earlier]) / (_CHANGE_TICKS * TICK_S))


def _source(result: LoopResult, partial: Partial, channel: int) -> Axis | None:
    """The signal of the channel that leaks into this one."""
    terms = [
        term for effect in result.new.effects for term in effect.terms if isinstance(term, CrosstalkTerm)
    ]
    for leak in (leak for term in terms for leak in term.leaks if leak.to == CHANNELS[channel]):
        signal = result.observations.signal[partial.rows, CHANNELS.index(leak.source)]
        return Axis(f"{leak.source} as predicted, from rest, counts", signal)
    return None
