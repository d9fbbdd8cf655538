"""Covariate: the error depends on another recorded column, such as the material."""

from collections.abc import Iterable
from typing import Final

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from taxel.windows import ExtraFeature
from taxel_models.loop.basis import Floats, Joined
from taxel_models.loop.effects.drivers import Driver, given, weighted
from taxel_models.loop.effects.effect import Candidate, Effect, Online, Remaining
from taxel_models.loop.effects.gain import Gain
from taxel_models.loop.observations import Observations
from taxel_models.recordings.kinds import are_kinds

MOST_PAIRED: Final = 16
"""The most kinds that may have a constant and a gain: with more, there are more weights than blocks."""

BOTH: Final = "constant and gain by kind"
"""The form that has both."""

FEWEST_CONTACTS_OF_A_KIND: Final = 2
"""A kind that has one contact cannot be told from an offset of this contact."""


def _both(offsets: Candidate, gains: Candidate) -> Candidate:
    """A constant and a gain for each kind."""
    size = offsets.basis.size

    def online(weights: Floats) -> Online:
        first, second = offsets.online(weights[:, :size]), gains.online(weights[:, size:])
        return Online((*first.terms, *second.terms), first.extras)

    def again(observations: Observations) -> Candidate:
        assert offsets.again is not None
        assert gains.again is not None
        return _both(offsets.again(observations), gains.again(observations))

    return Candidate(
        offsets.effect,
        BOTH,
        Joined(offsets.basis, gains.basis),
        weight_names=(
            *(f"constant, {name}" for name in offsets.weight_names),
            *(f"gain, {name}" for name in gains.weight_names),
        ),
        weight_units=(*("counts",) * size, *("relative",) * gains.basis.size),
        uneven=True,
        contains=gains.contains,
        online=online,
        again=again,
    )


def kind_extra(column: str, values: Floats, kind: float) -> ExtraFeature:
    """Whether a column (n,) has a value. Users of the model give it; its default is its share of rows."""
    share = float((values == kind).mean())
    return ExtraFeature(name=f"{column}={kind:g}", unit="0 or 1", default=share, taken_by="effects")


class Covariate(Effect):
    """A constant for each kind, or a line in an amount. The column NAME has the effect `covariate:NAME`."""

    name = "covariate"
    equation = "delta_c = w_c,kind (about the mean of kinds) + g_c,kind (p_c - rest_c); or w_c (x - mean)"
    source = "definition"
    signature = "the residual's mean differs between kinds, or follows the amount"

    def __init__(self, column: str) -> None:
        self.column = column

    @property
    @override
    def label(self) -> str:
        return f"{self.name}:{self.column}"

    @override
    def out_of_scope(self, observations: Observations) -> str | None:
        values = observations.covariates[self.column]
        kinds = np.unique(values)
        if len(kinds) < 2 or not are_kinds(kinds):
            return None
        contacts = [len(np.unique(observations.contact[values == kind])) for kind in kinds]
        if np.median(contacts) < FEWEST_CONTACTS_OF_A_KIND:
            return f"most values of {self.column} have one contact each: they number the contacts"
        return None

    @override
    def forms(self, observations: Observations, remaining: Remaining) -> Iterable[Candidate]:
        # Of a kind that nothing can be fitted to, nothing is known.
        kinds = np.unique(observations.covariates[self.column][remaining.fit])
        if len(kinds) < 2:
            return
        if are_kinds(kinds):
            yield self._constants(observations, kinds, remaining.fit)
            yield self._gains(observations, kinds)
        else:
            driver = given(observations, self.column, "")
            yield weighted(
                observations, self.label, "line", "unit", [driver], weight_units=("counts per unit",)
            )

    @override
    def finer(
        self, observations: Observations, best: Candidate, fit: NDArray[np.bool_]
    ) -> Iterable[Candidate]:
        # Each may be the whole cause, and only one of them what another cause is like. Once it is named,
        # kinds may have both.
        kinds = np.unique(observations.covariates[self.column][fit])
        if are_kinds(kinds) and len(kinds) <= MOST_PAIRED and best.form_itself != BOTH:
            constants = self._constants(observations, kinds, fit)
            yield _both(constants, self._gains(observations, kinds))

    def _constants(self, observations: Observations, kinds: Floats, fit: NDArray[np.bool_]) -> Candidate:
        """About the mean of the fit part, they sum to 0 there: no kind stands for what all share."""
        drivers, name = self._are(observations, kinds), self.label
        return weighted(
            observations,
            name,
            "by kind",
            "unit",
            drivers,
            rows=fit,
            weight_units=("counts",),
            uneven=True,
        )

    def _gains(self, observations: Observations, kinds: Floats) -> Candidate:
        """About their mean, a kind that other folds lack would stand for a gain that all share."""
        return weighted(
            observations,
            self.label,
            "gain by kind",
            "signal",
            self._are(observations, kinds),
            centred=False,
            weight_units=("relative",),
            uneven=True,
            contains=Gain.name,
        )

    def _are(self, observations: Observations, kinds: Floats) -> list[Driver]:
        values = observations.covariates[self.column]
        extras = [kind_extra(self.column, values, kind) for kind in kinds]
        return [
            Driver(extra.name, (values == kind).astype(np.float64), extra)
            for extra, kind in zip(extras, kinds, strict=True)
        ]
