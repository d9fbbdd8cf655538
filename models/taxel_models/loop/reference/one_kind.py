"""What a model gets wrong on one kind alone, such as one of several materials."""

from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Final, Self

import numpy as np
from scipy import stats

from taxel.errors import RecordingError
from taxel.held_out_residual import CorrelatedResidual, KindResidual, KnownKind, OwnStructure, OwnWave
from taxel_models.loop.basis import Floats
from taxel_models.loop.blocks import cut
from taxel_models.loop.effects.interference import own_waves
from taxel_models.loop.effects.registry import candidates
from taxel_models.loop.inference.constants import Constants
from taxel_models.loop.inference.kinds import figures, herfindahl, kind_name, of_figures
from taxel_models.loop.inference.scoring import Progress, silent
from taxel_models.loop.inference.whitening import NoiseShape
from taxel_models.loop.observations import FEWEST_CONTACTS, Observations
from taxel_models.loop.reference.correlated import correlated_structure
from taxel_models.loop.reference.own_structure import KEPT, MEAN, own_residual

FEWEST_ROWS: Final = 500
"""5 s, to tell how large the error on a kind is."""

FEWEST_ROWS_OF_STRUCTURE: Final = 1000
"""10 s, to tell what effects explain of it."""

FEWEST_KINDS: Final = 3
"""To tell how far kinds differ."""

DEVIATIONS: Final = 2.0
"""Standard deviations above the mean over kinds: what nearly all kinds stay below."""

OF_ALL_KINDS: Final = 4
"""Contacts of a kind that the mean over kinds counts for."""

RECORDED: Final = 8
"""Contacts of another recording."""

CONFIDENCE: Final = 0.95
"""That a recording of the kind shows no more."""

DIGITS: Final = 3
"""Significant ones that a manifest keeps of each kind."""


@dataclass(frozen=True)
class _Shown:
    """What one kind shows: each effect by itself, and beside what all channels have in common."""

    structure: Mapping[str, OwnStructure]
    correlated: Mapping[str, OwnStructure]

    @classmethod
    def by(
        cls,
        observations: Observations,
        shape: NoiseShape,
        correlated: CorrelatedResidual | None,
        constants: Constants,
    ) -> Self:
        """The rows of a kind.

        Args:
            shape: of the noise of all kinds, by which other recordings are whitened, too: how much is left
                of an effect depends on it.

        Raises:
            RecordingError: they are too few.
        """
        structure = own_residual(observations, constants, silent, MEAN, shape).structure
        if correlated is None:
            return cls(structure, {})
        blocks = cut(observations, seed=0, held_out=KEPT)
        return cls(structure, correlated_structure(observations, blocks, correlated, constants, MEAN))

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
    progress: Progress,
) -> KindResidual | None:
    """Of a recording of one value of a column; None where fewer than three values have enough rows.

    Of a value that has none, all values together say how much it may show.

    Args:
        shape: of the noise of all values.
    """
    values = observations.covariates[column]
    std: dict[str, Floats] = {}
    mean: dict[str, _Shown] = {}
    waves: dict[str, tuple[OwnWave, ...]] = {}
    contacts: dict[str, int] = {}
    kinds, rows = np.unique(values, return_counts=True)
    for kind in kinds[rows >= FEWEST_ROWS]:
        name = kind_name(kind)
        progress(f"{column} {name}")
        part = observations.kept(values == kind)
        std[name] = np.sqrt((part.residual**2).mean(axis=0))
        waves[name] = own_waves(observations, values == kind)
        contacts[name] = len(np.unique(part.contact))
        if len(part) >= FEWEST_ROWS_OF_STRUCTURE:
            with suppress(RecordingError):
                mean[name] = _Shown.by(part, shape, correlated, constants)
    if len(mean) < FEWEST_KINDS:
        return None
    structures = [one.structure for one in mean.values()]
    beside = [one.correlated for one in mean.values()]
    parts = [_figures_of(one.structure, std[name]) for name, one in mean.items()]
    # What differs from contact to contact, a few contacts do not tell.
    steady = [effect.label for effect in candidates(observations) if effect.is_steady]
    known = {}
    for name, own_std in std.items():
        own = mean.get(name, _Shown({}, {})).without(steady if contacts[name] < FEWEST_CONTACTS else ())
        more = constants.usual_of_kind
        may = _may_show(parts, _figures_of(own.structure, own_std), contacts[name], more)
        counts = {effect: found * _squared_counts(own_std) for effect, found in may.items()}
        correlated_may = _may_show(
            [_figures_of(one) for one in beside], _figures_of(own.correlated), contacts[name], more
        )
        known[name] = KnownKind(
            std=tuple(own_std.tolist()),
            structure=of_figures(_rounded(counts), structures),
            correlated=of_figures(_rounded(correlated_may), beside),
            waves=waves[name],
        )
    return KindResidual(
        std=tuple(np.sqrt(np.mean([std[name] ** 2 for name in mean], axis=0)).tolist()),
        structure=of_figures(_may_show([_figures_of(one) for one in structures]), structures),
        herfindahl=herfindahl(values),
        correlated=of_figures(_may_show([_figures_of(one) for one in beside]), beside),
        kinds=known,
    )


def _figures_of(structure: Mapping[str, OwnStructure], std: Floats | None = None) -> dict[str, Floats]:
    """(2, 21) log odds and gain of each effect; with a residual's size, gains as parts of its square."""
    unit = 1.0 if std is None else _squared_counts(std)
    return {name: figures(own) / unit for name, own in structure.items()}


def _squared_counts(std: Floats) -> Floats:
    """(2, 21) what parts of a squared error are multiplied by; log odds stay."""
    return np.array([np.ones_like(std), np.maximum(std**2, 1e-9)])


def _may_show(
    kinds: Sequence[Mapping[str, Floats]],
    own: Mapping[str, Floats] | None = None,
    contacts: int = 0,
    more: float = 1.0,
) -> dict[str, Floats]:
    """What a kind may show of each effect.

    Few contacts tell little of what a kind has itself, so that the mean over kinds counts, too, as if it
    were some more of its contacts. Of their mean, a recording may show the more, the fewer they are: as
    with variances of few samples that are moderated by those of others (Smyth 2004). Without own figures,
    a kind may show what nearly all kinds do.

    Args:
        kinds: figures of each kind.
        own: those that the kind has.
        contacts: of the kind.
        more: how many times as much a recording may show where many contacts tell it.
    """
    may, known = {}, OF_ALL_KINDS + contacts
    for name in sorted({name for one in kinds for name in one}):
        found = np.array([one[name] for one in kinds if name in one])
        if len(found) < FEWEST_KINDS:
            continue
        mean = found.mean(axis=0)
        may[name] = (
            more * _may_differ(known) * (OF_ALL_KINDS * mean + contacts * own[name]) / known
            if own and name in own
            else mean + DEVIATIONS * found.std(axis=0, ddof=1)
        )
    return may


def _may_differ(contacts: int) -> float:
    """By what factor so few contacts' mean may be below that of others, over the same for many contacts."""
    many = stats.chi2.ppf(CONFIDENCE, RECORDED) / RECORDED
    return float(stats.f.ppf(CONFIDENCE, RECORDED, contacts) / many)


def _rounded(structure: Mapping[str, Floats]) -> dict[str, Floats]:
    """With so many digits as a manifest keeps."""
    return {
        name: np.array([[float(f"{value:.{DIGITS}g}") for value in row] for row in found])
        for name, found in structure.items()
    }
