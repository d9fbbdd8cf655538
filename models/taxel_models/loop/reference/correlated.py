"""How a model's own held-out errors are correlated between channels, and what is usual beside that."""

from collections.abc import Sequence

import numpy as np

from taxel.channels import CHANNELS
from taxel.held_out_residual import CorrelatedResidual, OwnStructure
from taxel_models.loop.basis import Floats
from taxel_models.loop.blocks import Blocks
from taxel_models.loop.effects.effect import Candidate, Effect, Remaining
from taxel_models.loop.effects.registry import candidates
from taxel_models.loop.inference.constants import Constants
from taxel_models.loop.inference.correlated_channels import CorrelatedChannels
from taxel_models.loop.inference.evidence import Bases, weigh
from taxel_models.loop.inference.few_channels_search import FewChannelsSearch
from taxel_models.loop.inference.whitening import Bins, NoiseShape, Whitening
from taxel_models.loop.observations import Observations
from taxel_models.loop.reference.gain_limit import gain_limit
from taxel_models.loop.reference.own_structure import MEAN, OPEN
from taxel_models.loop.reference.precision import (
    FEWEST_PARTS,
    likeliest_own_noise,
    parts_of,
    precision_of,
    without_itself,
)
from taxel_models.loop.status import StatusCallback, silent


def correlated_residual(
    observations: Observations, blocks: Blocks, constants: Constants, progress: StatusCallback
) -> CorrelatedResidual | None:
    """Of the recordings that training held out; None where there are too few parts to test it.

    Args:
        blocks: almost all of them are the fit part.
        constants: of the inference.
        progress: is told what is looked at.
    """
    unit = observations.segment
    if len(np.unique(unit)) < FEWEST_PARTS:
        unit = blocks.of_row
    if len(np.unique(unit)) < FEWEST_PARTS:
        return None
    residual, bins = observations.residual, Bins.of(blocks, constants.bin_s)
    # Errors of neighbouring bins are alike, too: channels are compared without that.
    alone = Whitening(bins, NoiseShape.of(bins, residual, constants.fading_s), residual, constants)
    white = alone(bins.means(residual.T[:, :, None]))[:, :, 0].T * alone.scale
    parts = parts_of(unit)
    of_bins = [part[bins.order[bins.starts]] for part in parts]
    own_noise = likeliest_own_noise(white, of_bins)
    # Each part is judged by the precision of the others, as another recording is.
    whiten = without_itself(parts, [precision_of(white[~part], own_noise) for part in of_bins])
    shape = NoiseShape.of(bins, whiten(residual), constants.fading_s)
    known = CorrelatedResidual(
        precision=tuple(map(tuple, precision_of(white, own_noise).tolist())),
        shared=tuple(shape.shared.tolist()),
        fading=tuple(shape.fading.tolist()),
    )
    channels = CorrelatedChannels(residual, bins, known, constants, whiten)
    weights = alone.row_weights(len(observations)).mean(axis=1)
    structure = _structure_of(channels, observations, blocks, weights, OPEN, progress)
    return known.model_copy(update={"structure": structure})


def correlated_structure(
    observations: Observations, blocks: Blocks, known: CorrelatedResidual, constants: Constants
) -> dict[str, OwnStructure]:
    """What a part of these recordings, such as one kind, shows beside what its channels have in common."""
    residual, bins = observations.residual, Bins.of(blocks, constants.bin_s)
    channels = CorrelatedChannels(residual, bins, known, constants)
    shape = NoiseShape.of(bins, residual, constants.fading_s)
    weights = Whitening(bins, shape, residual, constants).row_weights(len(observations)).mean(axis=1)
    return _structure_of(channels, observations, blocks, weights, MEAN, silent)


def _structure_of(
    channels: CorrelatedChannels,
    observations: Observations,
    blocks: Blocks,
    row_weights: Floats,
    confidence: float,
    progress: StatusCallback,
) -> dict[str, OwnStructure]:
    remaining = Remaining(observations.residual, blocks.fit, row_weights)
    beside = channels.beside_named(remaining.residual, [])
    structure = {}
    for effect in candidates(observations):
        if effect.is_costly or effect.out_of_scope(observations) is not None:
            continue
        progress(effect.label)
        if effect.follows is not None:
            search = FewChannelsSearch(channels, observations, remaining, beside, effect)
            structure[effect.label] = _of_few(search, len(channels.bins), confidence)
        elif forms := list(effect.forms(observations, remaining)):
            structure[effect.label] = _of_many(channels, effect, forms, beside.bases(()))
    return structure


def _of_few(search: FewChannelsSearch, bins: int, confidence: float) -> OwnStructure:
    """What an effect explains in each electrode, alone or beside others: log odds and gain, by bins."""
    log_evidence, gain = np.zeros((2, len(CHANNELS)))
    # Beside others that change, too, a channel may show more: neighbours hide each other.
    for added in (*search.alone(), *search.added()):
        channel = added.channel
        limit = gain_limit(added.seen[:, None], added.unseen[:, None], confidence)
        log_evidence[channel] = max(log_evidence[channel], added.log_evidence)
        gain[channel] = max(gain[channel], float(limit[0]))
    return OwnStructure(
        log_evidence=tuple((log_evidence / bins).tolist()), gain=tuple((gain / bins).tolist())
    )


def _of_many(
    channels: CorrelatedChannels, effect: Effect, forms: Sequence[Candidate], bases: Bases
) -> OwnStructure:
    """What an effect of many channels explains: log odds of each whitened channel, by bins."""
    bases = bases.of_constant if effect.is_constant else bases
    found = [
        weigh(products, fitting, channels.constants)
        for products, fitting in channels.products_of_many(forms, bases)
    ]
    # Where each form stands for itself, only the likely ones are usual, and the likeliest in any case.
    least = min(0.0, max(one.log_evidence for one in found)) if effect.fits_nothing else -np.inf
    kept = [(form, one) for form, one in zip(forms, found, strict=True) if one.log_evidence >= least]
    odds = np.max([np.maximum(one.by_channel, 0.0) for _, one in kept], axis=0) / bases.beside.bins
    names = {form.form_itself for form, _ in kept} if effect.fits_nothing else ()
    return OwnStructure(
        log_evidence=tuple(odds.tolist()),
        gain=(0.0,) * len(CHANNELS),
        forms=tuple(sorted(names)),
    )
