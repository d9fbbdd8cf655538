"""What a model gets wrong on one kind alone, such as one of several materials."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from taxel.errors import RecordingError
from taxel.held_out_residual import CorrelatedResidual, KindResidual, KnownKind, OwnStructure, OwnWave
from taxel_models.loop.basis import Floats
from taxel_models.loop.blocks import cut
from taxel_models.loop.effects.interference import own_waves
from taxel_models.loop.effects.registry import candidates
from taxel_models.loop.inference.constants import Constants
from taxel_models.loop.inference.kinds import figures, herfindahl, kind_name, of_figures
from taxel_models.loop.inference.whitening import NoiseShape
from taxel_models.loop.observations import FEWEST_CONTACTS, Observations
from taxel_models.loop.reference.correlated import correlated_structure
from taxel_models.loop.reference.gain_limit import times_for_few
from taxel_models.loop.reference.own_structure import KEPT, MEAN, own_residual
from taxel_models.loop.status import StatusCallback, silent

FEWEST_ROWS: Final = 500
"""5 s, to tell how large the error on a kind is."""

FEWEST_ROWS_OF_STRUCTURE: Final = 1000
"""10 s, to tell what effects explain of it."""

FEWEST_KINDS: Final = 3
"""To tell how far kinds differ."""

DEVIATIONS: Final = 2.0
"""Standard deviations above the mean over kinds: what nearly all of these kinds stay below."""

FURTHER_KIND: Final = 0.995
"""The confidence that a further kind shows no more of an effect. About ten effects are looked for, and each
may be wrong."""

OF_ALL_EFFECTS: Final = 4
"""How far kinds differ in one effect: the mean over all effects counts as much as so many kinds."""

LEAST_PART: Final = 0.01
"""Of the largest gain of an effect: a kind with less counts as one with this part."""

OF_ALL_KINDS: Final = 4
"""Contacts of a kind that the mean over kinds counts for."""

CONFIDENCE: Final = 0.95
"""That a recording of the kind shows no more."""

DIGITS: Final = 3
"""Significant ones that a manifest keeps of each kind."""


@dataclass(frozen=True)
class _Shown:
    """What one kind shows.

    Attributes:
        std: (21,) root of the mean square of the residual, counts.
        contacts: how many there are.
        waves: of the residual.
        structure: of each effect by itself; empty where there are too few rows.
        correlated: likewise, beside what all channels have in common.
    """

    std: Floats
    contacts: int
    waves: tuple[OwnWave, ...]
    structure: Mapping[str, OwnStructure] = field(default_factory=dict)
    correlated: Mapping[str, OwnStructure] = field(default_factory=dict)

    @classmethod
    def by(
        cls,
        observations: Observations,
        rows: NDArray[np.bool_],
        shape: NoiseShape,
        correlated: CorrelatedResidual | None,
        constants: Constants,
    ) -> Self:
        """The rows (n,) of a kind.

        Args:
            shape: of the noise of all kinds. Other recordings are whitened by it, too, and how much is
                left of an effect depends on it.
        """
        part = observations.kept(rows)
        std = np.sqrt((part.residual**2).mean(axis=0))
        found = cls(std, len(np.unique(part.contact)), own_waves(observations, rows))
        if len(part) < FEWEST_ROWS_OF_STRUCTURE:
            return found
        try:
            structure = own_residual(part, constants, silent, MEAN, shape).structure
            beside: Mapping[str, OwnStructure] = {}
            if correlated is not None:
                blocks = cut(part, seed=0, held_out=KEPT)
                beside = correlated_structure(part, blocks, correlated, constants)
        except RecordingError:
            return found
        return replace(found, structure=structure, correlated=beside)

    def without(self, effects: Collection[str]) -> Self:
        """The same without some effects."""
        structure, correlated = (
            {name: own for name, own in found.items() if name not in effects}
            for found in (self.structure, self.correlated)
        )
        return replace(self, structure=structure, correlated=correlated)


def residual_of_one_kind(
    observations: Observations,
    column: str,
    shape: NoiseShape,
    correlated: CorrelatedResidual | None,
    constants: Constants,
    progress: StatusCallback,
) -> KindResidual | None:
    """Of a recording of one value of a column; None where fewer than three values have enough rows.

    Of a value that has none, all values together say how much it may show.

    Args:
        shape: of the noise of all values.
    """
    values = observations.covariates[column]
    shown: dict[str, _Shown] = {}
    kinds, rows_each = np.unique(values, return_counts=True)
    for kind in kinds[rows_each >= FEWEST_ROWS]:
        name = kind_name(kind)
        progress(f"{column} {name}")
        shown[name] = _Shown.by(observations, values == kind, shape, correlated, constants)
    told = [one for one in shown.values() if one.structure]
    if len(told) < FEWEST_KINDS:
        return None
    structures = [one.structure for one in told]
    beside = [one.correlated for one in told]
    parts = [_figures_of(one.structure, one.std) for one in told]
    whole = [_figures_of(one) for one in beside]
    # What differs from contact to contact, a few contacts do not tell.
    steady = [effect.label for effect in candidates(observations) if effect.is_steady]
    known, more = {}, constants.usual_of_kind
    for name, one in shown.items():
        own = one.without(steady if one.contacts < FEWEST_CONTACTS else ())
        may = _may_show(parts, _figures_of(own.structure, own.std), own.contacts, more)
        counts = {effect: found * _squared_counts(own.std) for effect, found in may.items()}
        correlated_may = _may_show(whole, _figures_of(own.correlated), own.contacts, more)
        known[name] = KnownKind(
            std=tuple(own.std.tolist()),
            structure=of_figures(_rounded(counts), structures),
            correlated=of_figures(_rounded(correlated_may), beside),
            waves=own.waves,
        )
    return KindResidual(
        std=tuple(np.sqrt(np.mean([one.std**2 for one in told], axis=0)).tolist()),
        # A further kind may show any form.
        structure=of_figures(_further_may_show([_figures_of(one) for one in structures]), []),
        herfindahl=herfindahl(values),
        correlated=of_figures(_further_may_show(whole), beside),
        kinds=known,
    )


def _figures_of(structure: Mapping[str, OwnStructure], std: Floats | None = None) -> dict[str, Floats]:
    """(2, 21) log odds and gain of each effect; with a residual's size, gains as parts of its square."""
    unit = 1.0 if std is None else _squared_counts(std)
    return {name: figures(own) / unit for name, own in structure.items()}


def _squared_counts(std: Floats) -> Floats:
    """(2, 21) what parts of a squared error are multiplied by; log odds stay."""
    return np.array([np.ones_like(std), np.maximum(std**2, 1e-9)])


def _nearly_all_show(kinds: Sequence[Mapping[str, Floats]]) -> dict[str, Floats]:
    """Of each effect, what nearly all of these kinds show."""
    return {
        name: found.mean(axis=0) + DEVIATIONS * found.std(axis=0, ddof=1)
        for name, found in _by_effect(kinds).items()
    }


def _further_may_show(kinds: Sequence[Mapping[str, Floats]]) -> dict[str, Floats]:
    """Of each effect, what a further kind may show: the upper end of a prediction interval.

    Kinds differ by factors, so logarithms of their gains are taken as normal. A few kinds tell badly how
    far they differ: their variance is moderated by the mean over effects (Smyth 2004).
    """
    found = _by_effect(kinds)
    logs = {name: _log_gains(own) for name, own in found.items()}
    spread = [own.var(ddof=1) for own in logs.values()]
    usual = _nearly_all_show(kinds)
    return {
        name: np.maximum(
            usual[name], own.mean(axis=0) * _times_for_a_further(logs[name], float(np.mean(spread)))
        )
        for name, own in found.items()
    }


def _log_gains(own: Floats) -> Floats:
    """(kinds,) logarithms of an effect's gains, mean over channels, of figures (kinds, 2, 21)."""
    gains = own[:, 1].mean(axis=1)
    return np.asarray(np.log(np.maximum(gains, max(LEAST_PART * gains.max(), 1e-12))))


def _times_for_a_further(logs: Floats, usual: float) -> float:
    """How many times their mean gain a further kind may show.

    Args:
        logs: (kinds,) logarithms of the gains.
        usual: variance of such logarithms, mean over effects.
    """
    kinds = len(logs)
    freedom = OF_ALL_EFFECTS + kinds - 1
    variance = (OF_ALL_EFFECTS * usual + (kinds - 1) * logs.var(ddof=1)) / freedom
    above = stats.t.ppf(FURTHER_KIND, freedom) * np.sqrt(variance * (1.0 + 1.0 / kinds))
    return float(np.exp(logs.mean() + above) / np.exp(logs).mean())


def _may_show(
    kinds: Sequence[Mapping[str, Floats]], own: Mapping[str, Floats], contacts: int, more: float
) -> dict[str, Floats]:
    """Of each effect, what a kind may show; without own figures, what nearly all kinds show.

    Args:
        kinds: figures of each kind.
        own: those that the kind has.
        contacts: of the kind.
        more: how many times its own figures a recording may show, if many contacts tell them.
    """
    means = {name: found.mean(axis=0) for name, found in _by_effect(kinds).items()}
    moderated = {
        name: more * moderated_limit(own[name], mean, contacts)
        for name, mean in means.items()
        if name in own
    }
    return {**_nearly_all_show(kinds), **moderated}


def _by_effect(kinds: Sequence[Mapping[str, Floats]]) -> dict[str, Floats]:
    """(kinds, 2, 21) figures of each effect that enough kinds have."""
    found = {
        name: np.array([one[name] for one in kinds if name in one])
        for name in sorted({name for one in kinds for name in one})
    }
    return {name: own for name, own in found.items() if len(own) >= FEWEST_KINDS}


def moderated_limit(own: Floats, mean: Floats, contacts: int) -> Floats:
    """What a recording may show, as a multiple of what it might if all contacts of its kind were known.

    A few contacts tell little of their kind, so the mean over kinds counts as `OF_ALL_KINDS` more of
    them. The limit above their mean is higher, the fewer there are. Variances of few samples are
    moderated so (Smyth 2004).

    Args:
        own: of a kind.
        mean: over kinds; the shape of `own`.
        contacts: of the kind.
    """
    known = OF_ALL_KINDS + contacts
    moderated = (OF_ALL_KINDS * mean + contacts * own) / known
    return np.asarray(moderated * times_for_few(known, CONFIDENCE))


def _rounded(structure: Mapping[str, Floats]) -> dict[str, Floats]:
    """With so many digits as a manifest keeps."""
    return {
        name: np.array([[float(f"{value:.{DIGITS}g}") for value in row] for row in found])
        for name, found in structure.items()
    }
