"""Kinds: a model errs in its own way on each material, and a recording may have few of them."""

from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from taxel.channels import CHANNELS
from taxel.held_out_residual import (
    HeldOutResidual,
    KindResidual,
    KnownKind,
    OwnStructure,
    OwnWave,
    known_as,
)
from taxel.manifest import Manifest
from taxel_models.loop.basis import Floats
from taxel_models.loop.effects.covariate import Covariate
from taxel_models.loop.effects.gain import Gain
from taxel_models.loop.effects.offset import Offset
from taxel_models.loop.inference.constants import Constants
from taxel_models.loop.inference.contact_offset import ContactOffset
from taxel_models.loop.observations import Observations


def counted(effect: str, std: Floats, scale: Floats) -> Floats:
    """(2, 21) parts of an effect's usual log odds and usual gain that count where the residual has a scale.

    Where other effects make the residual larger, the model's own structure is a smaller part of it. Where
    the residual is smaller than the model's own, so is what is usual of it. Means are not: they scatter
    from recording to recording, and a residual's size leaves them out.

    Args:
        std: (21,) of the model's own held-out residual, counts.
        scale: (21,) of the residual, counts.
    """
    odds = np.minimum(1.0, (std / scale) ** 2)
    gain = np.minimum(1.0, (scale / np.maximum(std, 1e-9)) ** 2)
    return np.array([odds, np.ones(len(CHANNELS)) if effect == Offset.name else gain])


def herfindahl(values: Floats) -> float:
    """Sum of the squared shares of the rows that each value has; 1 where there is one value only."""
    _, rows = np.unique(values, return_counts=True)
    return float(((rows / len(values)) ** 2).sum())


def kind_name(value: float) -> str:
    """What a manifest calls a kind."""
    return f"{value:g}"


def of_its_kinds(
    reference: HeldOutResidual, observations: Observations, constants: Constants
) -> HeldOutResidual:
    """The reference, with what may be usual of the kinds that a recording has."""
    found = _of_known_kinds(reference, observations, constants)
    for column, new in new_kinds(observations).items():
        if column in reference.new_kinds:
            found = _with_new_kinds(found, reference.new_kinds[column], observations, new)
    return found.model_copy(update={"new_kinds": {}})


def trained_kinds(manifest: Manifest) -> Mapping[str, Sequence[float]]:
    """The kinds of each column that a model was trained on, as far as its manifest tells."""
    trained = manifest.trained_contacts
    return {} if trained is None else trained.kinds


def new_kinds(observations: Observations) -> dict[str, NDArray[np.bool_]]:
    """(n,) rows of kinds that the model was not trained on, by each column that has any."""
    known, columns = trained_kinds(observations.manifest), observations.covariates
    new = {name: ~np.isin(values, known[name]) for name, values in columns.items() if name in known}
    return {name: rows for name, rows in new.items() if rows.any()}


def _with_new_kinds(
    known: HeldOutResidual,
    stand_ins: HeldOutResidual,
    observations: Observations,
    new: NDArray[np.bool_],
) -> HeldOutResidual:
    """What may be usual where some rows (n,) are of kinds that the model was not trained on.

    How wrong the model is on them, it does not know; stand-ins of it tell which part of the error each
    effect explains. A weight of all rows explains of these rows' error the square of their share, and one
    of each kind or contact their share. New kinds may be alike, so that their errors do not cancel out.
    """
    share = float(new.mean())
    energy = (observations.residual[new] ** 2).mean(axis=0)
    sources = [(stand_ins.structure, stand_ins.std)]
    sources += [(one.structure, one.std) for one in stand_ins.one_kind.values()]
    scale = np.maximum(observations.residual.std(axis=0), 1e-9)
    usual = _UsualOfKinds(known.structure)
    for name in known.structure.keys() & stand_ins.structure.keys():
        found = [
            figures(source[name]) * [np.ones_like(energy), energy / np.maximum(std, 1e-9) ** 2]
            for source, std in sources
            if name in source
        ]
        own = np.max(found, axis=0) / counted(name, np.array(known.std), scale)
        of_each = name == ContactOffset.name or name.startswith(f"{Covariate.name}:")
        usual.mix(name, own, share if of_each else share**2, [source for source, _ in sources])
    noise = np.array([(one.shared, one.fading) for one in (known, stand_ins)])
    shared, fading = (1.0 - share) * noise[0] + share * noise[1]
    return known.model_copy(
        update={
            "structure": usual.structure(),
            "shared": tuple(shared.tolist()),
            "fading": tuple(fading.tolist()),
        }
    )


def _of_known_kinds(
    reference: HeldOutResidual, observations: Observations, constants: Constants
) -> HeldOutResidual:
    """With what may be usual of few kinds.

    A weight of one kind is a common one plus one of its own. Where the own ones are independent of each
    other, a weight that is fitted to several kinds explains what the common one does, and of what the own
    ones do the share of the Herfindahl index of the kinds' rows. So a recording of one kind is judged as
    such, and one of as many kinds as the reference has as all of them together.
    """
    scale = np.maximum(observations.residual.std(axis=0), 1e-9)
    usual = _UsualOfKinds(reference.structure)
    correlated = _UsualOfKinds({} if reference.correlated is None else reference.correlated.structure)
    here = {column: one for column, one in reference.one_kind.items() if column in observations.covariates}
    waves = list(reference.waves)
    for column, one in here.items():
        covariate = Covariate(column).label
        if covariate not in usual.figures:
            # Too few were held out to compare kinds: each kind may have what one kind alone shows.
            alike = [
                figures(one.structure[name]) for name in (Gain.name, Offset.name) if name in one.structure
            ]
            usual.figures[covariate] = np.sum(alike, axis=0) if alike else np.zeros((2, len(CHANNELS)))
        values = observations.covariates[column]
        rows = _Rows.of(one, values)
        waves += rows.waves()
        few = herfindahl(values) - one.herfindahl
        alone = max(few, 0.0) / (1.0 - one.herfindahl)
        for name in list(usual.figures):
            # Few rows of a kind tell nothing of what ages.
            told = known_as(name, one.structure)
            if told is not None:
                unit = counted(name, np.array(reference.std), scale)
                usual.mix(name, rows.figures_of(told, scale) / unit, alone, [one.structure])
        if ContactOffset.name in usual.figures.keys() - one.structure.keys():
            # Of one kind, few contacts are held out; on some kinds, contacts scatter more.
            size = constants.usual_of_kind * rows.energy()
            more = np.array([np.ones_like(size), size / np.maximum(np.square(reference.std), 1e-9)])
            usual.mix(ContactOffset.name, usual.figures[ContactOffset.name] * more, alone, [])
        for name in one.correlated.keys() & correlated.figures.keys():
            correlated.mix(name, rows.correlated_figures_of(name), alone, [one.correlated])
    update: dict[str, object] = {"structure": usual.structure(), "one_kind": {}}
    if reference.correlated is not None:
        update["correlated"] = reference.correlated.model_copy(update={"structure": correlated.structure()})
    update["waves"] = tuple(_of_energy(wave, constants.usual_of_kind) for wave in waves)
    return reference.model_copy(update=update)


def _of_energy(wave: OwnWave, factor: float) -> OwnWave:
    return wave.model_copy(update={"energy": tuple(factor * energy for energy in wave.energy)})


@dataclass(frozen=True)
class _Rows:
    """The kinds of a recording's rows.

    Attributes:
        one: what is known of one kind, and of each.
        kinds: their names.
        rows: (kinds,) how many each has.
    """

    one: KindResidual
    kinds: tuple[str, ...]
    rows: NDArray[np.int64]

    @classmethod
    def of(cls, one: KindResidual, values: Floats) -> Self:
        """Of a column (n,)."""
        kinds, rows = np.unique(values, return_counts=True)
        return cls(one, tuple(kind_name(kind) for kind in kinds), rows)

    def energy(self) -> Floats:
        """(21,) mean square of the model's error on these kinds, counts²."""
        own = [np.square(self.one.kinds.get(kind, self.one).std) for kind in self.kinds]
        return np.asarray(np.average(own, axis=0, weights=self.rows))

    def figures_of(self, name: str, scale: Floats) -> Floats:
        """(2, 21) of an effect, as far as they count where the residual has a scale (21,), counts."""
        own = [
            figures(its.structure[name]) * counted(name, np.array(its.std), scale)
            for its in self._known(lambda its: name in its.structure)
        ]
        return np.asarray(np.average(own, axis=0, weights=self.rows))

    def correlated_figures_of(self, name: str) -> Floats:
        """(2, 21) of an effect, beside all channels."""
        own = [figures(its.correlated[name]) for its in self._known(lambda its: name in its.correlated)]
        return np.asarray(np.average(own, axis=0, weights=self.rows))

    def waves(self) -> list[OwnWave]:
        """Of each kind, as much as its share of the rows has."""
        shares = (self.rows / self.rows.sum()).tolist()
        return [
            _of_energy(wave, share)
            for kind, share in zip(self.kinds, shares, strict=True)
            if kind in self.one.kinds
            for wave in self.one.kinds[kind].waves
        ]

    def _known(self, has: Callable[[KnownKind], bool]) -> list[KindResidual | KnownKind]:
        """What is known of each kind, or of any one where its own lacks what is asked for."""
        each = (self.one.kinds.get(kind) for kind in self.kinds)
        return [self.one if its is None or not has(its) else its for its in each]


class _UsualOfKinds:
    """What is usual of a recording's kinds, beginning with what all kinds show together.

    Attributes:
        figures: (2, 21) of each effect.
    """

    def __init__(self, structure: Mapping[str, OwnStructure]) -> None:
        self.figures = {name: figures(own) for name, own in structure.items()}
        self._sources = defaultdict(list, {name: [structure] for name in structure})

    def mix(
        self, name: str, one: Floats, alone: float, sources: Sequence[Mapping[str, OwnStructure]]
    ) -> None:
        """Let a share of the recording stand for one kind alone, with figures (2, 21) from some structures.

        The forms that those structures name count only where most of the figure comes from them.
        """
        several = self.figures[name]
        self.figures[name] = np.maximum(several, (1.0 - alone) * several + alone * one)
        if alone * one[1].sum() > (1.0 - alone) * several[1].sum():
            self._sources[name].extend(sources)

    def structure(self) -> dict[str, OwnStructure]:
        """Of each effect."""
        return {
            name: _of_figures(own, all_forms(name, self._sources[name]))
            for name, own in self.figures.items()
        }


def all_forms(effect: str, sources: Sequence[Mapping[str, OwnStructure]]) -> tuple[str, ...]:
    """The forms of an effect that any of some structures names; none where one says that any may."""
    forms = [source[effect].forms for source in sources if effect in source]
    return tuple(sorted({name for own in forms for name in own})) if all(forms) else ()


def of_figures(
    structure: Mapping[str, Floats], sources: Sequence[Mapping[str, OwnStructure]]
) -> dict[str, OwnStructure]:
    """Figures (2, 21) of each effect, with the forms that the structures name from which they are."""
    return {name: _of_figures(own, all_forms(name, sources)) for name, own in structure.items()}


def _of_figures(own: Floats, forms: tuple[str, ...]) -> OwnStructure:
    odds, gain = own
    return OwnStructure(log_evidence=tuple(odds.tolist()), gain=tuple(gain.tolist()), forms=forms)


def figures(own: OwnStructure) -> Floats:
    """(2, 21) log odds and gain."""
    return np.array([own.log_evidence, own.gain])
