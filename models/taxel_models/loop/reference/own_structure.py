"""What each effect explains of a model's own held-out residual."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from typing import Final, NamedTuple

import numpy as np
from scipy import stats
from threadpoolctl import threadpool_limits

from taxel.channels import CHANNELS
from taxel.held_out_residual import AGEING, ALIKE, HeldOutResidual, OwnStructure
from taxel_models.loop.basis import Floats
from taxel_models.loop.blocks import Blocks, cut
from taxel_models.loop.effects.offset import Offset
from taxel_models.loop.effects.registry import candidates
from taxel_models.loop.inference.constants import Constants
from taxel_models.loop.inference.evidence import Weighed, held_out, weigh
from taxel_models.loop.inference.forms import WhitenedForm
from taxel_models.loop.inference.products import Products
from taxel_models.loop.inference.score import Score, t_of_folds
from taxel_models.loop.inference.scoring import Scoring
from taxel_models.loop.inference.whitening import Bins, NoiseShape
from taxel_models.loop.observations import Observations
from taxel_models.loop.reference.gain_limit import gain_limit
from taxel_models.loop.status import StatusCallback

LIKELY: Final = 0.5
"""Forms with this share of the log evidence of an effect's likeliest one count, too."""

KEPT: Final = 0.05
"""Blocks that the reference leaves out; the inference wants an evaluation part."""

FEWEST_FOR_MEAN: Final = 4
"""With fewer, blocks of a few seconds tell how far the mean error may lie."""

MEAN: Final = 0.5
"""The confidence of a limit that is the mean."""

OPEN: Final = 0.99
"""The confidence of the limit up to which few blocks leave open what an effect explains."""

ONE_ERROR: Final = 0.84
"""The confidence of one standard error, up to which offsets of contacts are usual."""


def structure_of(scoring: Scoring, confidence: float = OPEN) -> dict[str, OwnStructure]:
    """For each effect alone, its log odds and its gain for each bin.

    Of an effect's likely forms, the largest counts: another recording may show another one. Forms that age,
    and those with weights of each channel, may explain far more than others, so that a form is compared
    with those that have at most its freedom. Of a costly effect, and of one that is certain, only the
    likeliest form counts.

    Args:
        confidence: of the limit of what few blocks leave open; 0.5 for the mean itself.
    """
    with threadpool_limits(1):
        structure = {}
        for score in scoring.scores([]):
            once = score.effect.is_costly or score.form.candidate.certain
            if once or not score.effect.is_predictable:
                own = [_Form(score.form, score.weighed, own_gain(scoring, score, confidence))]
                structure[score.name] = _largest(own, len(scoring.bins))
                continue
            forms = _usual_forms(scoring, score, confidence) if score.effect.fits_nothing else ()
            for suffix, found in _by_freedom(_likely_forms(scoring, score, confidence)).items():
                structure[score.name + suffix] = _largest(found, len(scoring.bins), forms)
        return structure


class _Form(NamedTuple):
    """A likely form of an effect; (21,) what it takes off the squared error in every channel, counts²."""

    form: WhitenedForm
    weighed: Weighed
    gain: Floats

    @property
    def ages(self) -> bool:
        return self.form.candidate.ages

    @property
    def is_alike(self) -> bool:
        return self.form.candidate.fitting.pooled


def _by_freedom(likely: Sequence[_Form]) -> dict[str, list[_Form]]:
    """Forms that have at most some freedom, by what ends the effect's name then."""
    steady = [one for one in likely if not one.ages]
    found = {"": steady or list(likely)}
    if len(steady) not in (0, len(likely)):
        found[AGEING] = list(likely)
    for suffix, several in list(found.items()):
        alike = [one for one in several if one.is_alike]
        if len(alike) not in (0, len(several)):
            found[suffix + ALIKE] = alike
    return found


def _largest(found: Sequence[_Form], bins: int, forms: tuple[str, ...] = ()) -> OwnStructure:
    """The largest that some forms explain, for each bin."""
    odds = np.max([one.weighed.by_channel for one in found], axis=0)
    gain = max((one.gain for one in found), key=lambda gain: float(gain.sum()))
    return OwnStructure(
        log_evidence=tuple((np.maximum(odds, 0.0) / bins).tolist()),
        gain=tuple((np.maximum(gain, 0.0) / bins).tolist()),
        forms=forms,
    )


def _usual_forms(scoring: Scoring, score: Score, confidence: float) -> tuple[str, ...]:
    """Forms that the folds do not rule out, and the likeliest."""
    bases, found = scoring.bases([]), {score.form.candidate.form_itself}
    for form in scoring.forms_of(score.effect):
        products, fitting = Products.of(bases.beside, form.design), form.candidate.fitting
        tested = held_out(products, fitting, weigh(products, fitting, scoring.constants))
        limit = float(stats.t.ppf(confidence, len(tested.gain) - 1))
        if t_of_folds(tested.gain.sum(axis=1)) > -limit:
            found.add(form.candidate.form_itself)
    return tuple(sorted(found))


def _likely_forms(scoring: Scoring, score: Score, confidence: float) -> list[_Form]:
    """The form of a score, and those that are nearly as likely as the likeliest with as much freedom."""
    bases = scoring.bases([])
    base = bases.plain if score.effect.is_constant else bases.beside
    weighed = [
        (form, weigh(Products.of(base, form.design), form.candidate.fitting, scoring.constants))
        for form in scoring.forms_of(score.effect)
    ]
    likely = []
    for freedom in product((False, True), repeat=2):
        own_kind = [
            (form, own)
            for form, own in weighed
            if (form.candidate.ages, form.candidate.fitting.pooled) == freedom
        ]
        most = max((own.log_evidence for _, own in own_kind), default=0.0)
        if score.effect.fits_nothing and most <= 0.0:
            # No weight could make it smaller: the recordings speak against it.
            continue
        least = min(most, max(LIKELY * most, 0.0))
        likely += [(form, own) for form, own in own_kind if own.log_evidence >= least]
    return [
        _Form(form, own, own_gain(scoring, replace(score, form=form, weighed=own), confidence))
        for form, own in [
            (score.form, score.weighed),
            *(one for one in likely if one[0] is not score.form),
        ]
    ]


def own_gain(scoring: Scoring, score: Score, confidence: float = OPEN) -> Floats:
    """(21,) what an effect takes off the squared error in every channel, counts²; see `gain_limit`."""
    bases, counts = scoring.bases([]), scoring.whitening.scale**2
    if not score.effect.is_predictable:
        # Nothing is fitted to other folds, so that folds are independent of each other.
        by_fold = score.gain * bases.plain.noise * counts
        limit = float(stats.t.ppf(min(confidence, ONE_ERROR), len(score.gain) - 1))
        return np.asarray(by_fold.sum(axis=0) + limit * np.sqrt(len(by_fold)) * by_fold.std(axis=0, ddof=1))
    products = Products.of(bases.beside, score.form.design)
    if score.effect.is_constant:
        products = replace(products, base=bases.plain)
    fitting = score.form.candidate.fitting
    included = np.ones(len(CHANNELS)) if fitting.allowed is None else fitting.allowed.astype(np.float64)
    every = replace(score.weighed, included=included)
    folds = [held_out(products, fitting, every, seen=seen) for seen in (True, False)]
    seen, unseen = (tested.gain * tested.noise for tested in folds)
    return np.asarray(gain_limit(seen, unseen, confidence) * counts)


def own_residual(
    observations: Observations,
    constants: Constants,
    progress: StatusCallback,
    confidence: float = OPEN,
    shape: NoiseShape | None = None,
) -> HeldOutResidual:
    """What recordings show of what their model gets wrong.

    Args:
        progress: is told what is looked at.
        confidence: as in `structure_of`.
        shape: of the noise; None for that of these recordings.

    Raises:
        RecordingError: there are too few rows.
    """
    blocks = cut(observations, seed=0, held_out=KEPT)
    residual = observations.residual
    shape = shape or NoiseShape.of(Bins.of(blocks, constants.bin_s), residual, constants.fading_s)
    found = HeldOutResidual(
        rows=len(observations),
        std=tuple(np.sqrt((residual**2).mean(axis=0)).tolist()),
        shared=tuple(shape.shared.tolist()),
        fading=tuple(shape.fading.tolist()),
    )
    effects = candidates(observations)
    scoring = Scoring(observations, blocks, effects, found, constants, progress)
    structure = structure_of(scoring, confidence)
    if Offset.name in structure and confidence > MEAN:
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
    if len(np.unique(unit)) < FEWEST_FOR_MEAN:
        unit = blocks.of_row
    means = np.array([observations.residual[unit == one].mean(axis=0) for one in np.unique(unit)])
    count = len(means)
    return np.asarray(stats.t.ppf(0.975, count - 1) * means.std(axis=0, ddof=1) / np.sqrt(count))
