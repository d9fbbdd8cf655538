"""The reference: a model's own held-out residual, which says what the model gets wrong anyway."""

from collections.abc import Sequence
from typing import Final

import numpy as np
from scipy import stats

from taxel.errors import RecordingError
from taxel.manifest import HeldOutResidual, OwnStructure
from taxel_models.loop.basis import Floats
from taxel_models.loop.blocks import Blocks, cut
from taxel_models.loop.effects.offset import Offset
from taxel_models.loop.effects.registry import candidates
from taxel_models.loop.inference.constants import DECLARED, Constants
from taxel_models.loop.inference.own_structure import structure_of
from taxel_models.loop.inference.scoring import Scoring
from taxel_models.loop.inference.whitening import Bins, NoiseShape
from taxel_models.loop.observations import Observations, gather
from taxel_models.model import Model
from taxel_models.recordings import Recording

KEPT: Final = 0.05
"""Blocks that the reference leaves out; the inference wants an evaluation part."""

FEWEST_CONTACTS: Final = 4
"""With fewer, blocks of a few seconds tell how far the mean error may lie."""


def held_out_residual(
    model: Model, recordings: Sequence[Recording], constants: Constants = DECLARED
) -> HeldOutResidual | None:
    """Of a model and the recordings that its training held out; None where they are too short."""
    try:
        observations = gather(model, recordings)
        blocks = cut(observations, seed=0, held_out=KEPT)
    except RecordingError:
        return None
    residual = observations.residual
    shape = NoiseShape.of(Bins.of(blocks, constants.bin_s), residual, constants.fading_s)
    found = HeldOutResidual(
        rows=len(observations),
        std=tuple(np.sqrt((residual**2).mean(axis=0)).tolist()),
        shared=tuple(shape.shared.tolist()),
        fading=tuple(shape.fading.tolist()),
    )
    effects = candidates(observations)
    scoring = Scoring(observations, blocks, effects, found, constants, lambda _: None)
    structure = {
        name: OwnStructure(log_evidence=tuple(log_evidence.tolist()), gain=tuple(gain.tolist()))
        for name, (log_evidence, gain) in structure_of(scoring).items()
    }
    if Offset.name in structure:
        own = structure[Offset.name]
        gain = np.array(own.gain) + scoring.whitened_constant(_unknown_mean(observations, blocks))
        structure[Offset.name] = own.model_copy(update={"gain": tuple(gain.tolist())})
    return found.model_copy(update={"structure": structure})


def _unknown_mean(observations: Observations, blocks: Blocks) -> Floats:
    """(21,) half of the 95 % interval of the mean, counts: what a few contacts leave open.

    A model's mean error is known no better than its held-out contacts tell it, so a smaller offset of
    another recording is no news.
    """
    unit = observations.segment
    if len(np.unique(unit)) < FEWEST_CONTACTS:
        unit = blocks.of_row
    means = np.array([observations.residual[unit == one].mean(axis=0) for one in np.unique(unit)])
    count = len(means)
    return np.asarray(stats.t.ppf(0.975, count - 1) * means.std(axis=0, ddof=1) / np.sqrt(count))
