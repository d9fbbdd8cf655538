"""What is usual: how much of an effect the model's own held-out residual has."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from taxel.held_out_residual import AGEING, ALIKE, HeldOutResidual, OwnStructure, known_as
from taxel_models.loop.basis import Floats
from taxel_models.loop.effects.effect import Candidate
from taxel_models.loop.effects.gain import Gain
from taxel_models.loop.effects.load import Load
from taxel_models.loop.inference.evidence import HeldOut
from taxel_models.loop.inference.kinds import counted


class Usual:
    """What is usual of each effect, for the bins of a recording.

    Args:
        reference: the model's own held-out residual; None if it is not known, so that nothing is usual.
        fold: (bins,) of the cross-validation.
        scale: (21,) of the recording's residual, counts.
    """

    def __init__(self, reference: HeldOutResidual | None, fold: NDArray[np.int64], scale: Floats) -> None:
        self._is_known = reference is not None
        self._structure = {} if reference is None else _with_load(reference.structure)
        self._std = np.zeros(0) if reference is None else np.array(reference.std)
        self._scale = scale
        _, self._bins_each = np.unique(fold, return_counts=True)

    def knows(self, effect: str) -> bool:
        """Whether it says how much is usual of an effect; without any structure, nothing is usual."""
        return self._is_known and (not self._structure or effect in self._structure)

    def log_evidence(self, effect: str, candidate: Candidate | None = None) -> Floats | float:
        """(21,) log odds that the model's own residual gives a form of an effect."""
        own = self._of(effect, candidate)
        if own is None:
            return 0.0
        part, _ = counted(effect, self._std, self._scale)
        return np.asarray(np.array(own.log_evidence) * part * self._bins_each.sum())

    def gain(self, candidate: Candidate, tested: HeldOut) -> Floats | float:
        """(folds, 21) what a form of an effect takes off the model's own residual, over the noise.

        A form that ages takes off little where it is small, whether it is usual or not.
        """
        own = self._of(candidate.effect, candidate)
        if own is None:
            return 0.0
        _, part = counted(candidate.effect, self._std, self._scale)
        gain = part * np.array(own.gain)
        bins = bins_that_count(candidate, self._bins_each[:, None], tested.squared_change)
        return np.asarray(bins * gain / (tested.noise * self._scale**2))

    def _of(self, effect: str, candidate: Candidate | None) -> OwnStructure | None:
        """What the model's own residual has of a form, by what is known of forms with as much freedom."""
        name, form = effect, ""
        if candidate is not None:
            name += AGEING * candidate.ages + ALIKE * candidate.fitting.pooled
            form = candidate.form_itself
        known = known_as(name, self._structure)
        return self._structure[known] if known and self._structure[known].has(form) else None


def _with_load(structure: Mapping[str, OwnStructure]) -> Mapping[str, OwnStructure]:
    """The same, where what is usual of a gain is usual of a load, too: the one may stand for the other."""
    found = [structure[name] for name in (Load.name, Gain.name) if name in structure]
    if not found:
        return structure
    odds, gain = (
        tuple(np.max([getattr(own, part) for own in found], axis=0).tolist())
        for part in ("log_evidence", "gain")
    )
    return {**structure, Load.name: OwnStructure(log_evidence=odds, gain=gain)}


def bins_that_count(candidate: Candidate, bins: NDArray[np.int64], squared_change: Floats) -> Floats:
    """(folds, c) how many bins of each fold have what is usual of a form.

    Of a form that acts unevenly, a fold counts by how much it acts there.

    Args:
        bins: (folds, 1) of each fold.
        squared_change: (folds, c) that the form foretells.
    """
    if not candidate.acts_unevenly:
        return bins.astype(np.float64)
    return np.asarray(bins.sum() * squared_change / np.maximum(squared_change.sum(axis=0), 1e-12))
