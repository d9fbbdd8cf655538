"""From named effects to a corrected model: online forms, the features they need, and their predictions."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from taxel.channels import CHANNELS, COUNTS_MAX
from taxel.corrections import (
    CALIBRATION_AGE,
    CALIBRATION_EXTRAS,
    AppliedEffect,
    Composition,
    CountLimits,
    Parameter,
    Term,
)
from taxel.windows import ExtraFeature
from taxel_models.loop.attribution import Attribution, Named
from taxel_models.loop.basis import Floats
from taxel_models.loop.effects.effect import Online
from taxel_models.loop.observations import Observations

Windows = NDArray[np.float32]


@dataclass(frozen=True)
class NewEffects:
    """What turns a model into a corrected one.

    Attributes:
        effects: in the order in which they were named.
        extras: the features that they need beside the window.
    """

    effects: tuple[AppliedEffect, ...]
    extras: tuple[ExtraFeature, ...]

    @classmethod
    def of(cls, attribution: Attribution, parameters: dict[str, list[Parameter]]) -> "NewEffects":
        """Online forms of the effects that can be served.

        Args:
            parameters: of each effect, for people.
        """
        effects, extras = [], {}
        for named in attribution.named:
            online = named.candidate.online(named.served_weights)
            if not online.changes_something:
                continue
            effects.append(_applied(named, online, parameters.get(named.name, [])))
            extras.update({extra.name: extra for extra in online.extras})
        limits = _limits(attribution)
        if effects and limits is not None:
            effects[-1] = effects[-1].model_copy(update={"terms": (*effects[-1].terms, limits)})
        return cls(tuple(effects), tuple(extras.values()))


def _limits(attribution: Attribution) -> CountLimits | None:
    """Those of channels that are at one where the named effects lead beyond it; None without any."""
    observations = attribution.observations
    predicted = observations.predicted.copy()
    for named in attribution.named:
        if not named.candidate.moves:
            predicted += named.contribution
    beyond = observations.limits.beyond(observations.measured, predicted)
    channels = tuple(CHANNELS[column] for column in np.flatnonzero(beyond.any(axis=0)))
    return CountLimits(channels=channels, low=0.0, high=COUNTS_MAX) if channels else None


def _applied(named: Named, online: Online, parameters: Iterable[Parameter]) -> AppliedEffect:
    return AppliedEffect(
        name=named.name,
        about=f"{named.equation}; {named.candidate.form}",
        channels=named.channels,
        parameters=tuple(parameters),
        frame=online.frame,
        shift_ticks=online.shift_ticks,
        terms=online.terms,
    )


def corrected(first: Observations, attribution: Attribution, new: NewEffects) -> Floats:
    """(n, 21) what the corrected model gives at the observations' rows, by the forms that are served.

    Args:
        first: the observations before any input was moved: effects take features as they are given.
    """
    terms = [term for effect in new.effects for term in effect.terms]
    return composed(first, attribution.observations, terms, new.extras)


def composed(
    first: Observations, moved: Observations, terms: Iterable[Term], extras: Iterable[ExtraFeature]
) -> Floats:
    """(n, 21) what a model gives with terms added.

    Args:
        first: the observations before any input was moved.
        moved: the same with moved inputs, or `first`.
        extras: the features that the terms need beside the window.
    """
    columns = feature_columns(first, moved, extras)
    return Composition(terms).counts(moved.base, columns, start=moved.predicted)


def feature_columns(
    first: Observations, moved: Observations, extras: Iterable[ExtraFeature]
) -> dict[str, Floats]:
    """The features of the corrected model's windows by name, each (n,), as its terms take them."""
    shift = moved.shift_ticks - first.shift_ticks
    windows = first.windows[first.rows_before(shift)]
    names = first.manifest.spec.unshifted.features
    columns = {name: windows[:, place].astype(np.float64) for place, name in enumerate(names)}
    return columns | {extra.name: _column(first, extra) for extra in extras}


def served_windows(first: Observations, attribution: Attribution, new: NewEffects, rows: int) -> Windows:
    """(m, f) windows as the corrected model takes them, m up to `rows`, evenly spaced."""
    some = np.linspace(0, len(first) - 1, min(rows, len(first))).astype(np.int64)
    shift = attribution.observations.shift_ticks - first.shift_ticks
    extras = [_column(first, extra)[some] for extra in new.extras]
    return np.column_stack([first.windows[first.rows_before(shift)][some], *extras]).astype(np.float32)


def _column(observations: Observations, extra: ExtraFeature) -> Floats:
    if extra.history is not None:
        return observations.history(extra.history)
    if observations.calibration is not None:
        if extra in CALIBRATION_EXTRAS:
            return observations.calibration.offsets[:, CALIBRATION_EXTRAS.index(extra)]
        if extra == CALIBRATION_AGE:
            return observations.calibration.age_s
    name, _, kind = extra.name.partition("=")
    if kind:
        return np.asarray(observations.covariates[name] == float(kind), dtype=np.float64)
    return observations.covariates[extra.name]
