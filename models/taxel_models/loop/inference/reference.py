"""The reference: a model's own held-out residual, which says what the model gets wrong anyway."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Final

import numpy as np
from scipy import stats

from taxel.errors import RecordingError
from taxel.held_out_residual import CorrelatedResidual, HeldOutResidual, KindResidual, OwnStructure
from taxel_models.loop.basis import Floats
from taxel_models.loop.blocks import Blocks, cut
from taxel_models.loop.channel_history import usual_changes
from taxel_models.loop.effects.offset import Offset
from taxel_models.loop.effects.registry import candidates
from taxel_models.loop.inference.constants import DECLARED, Constants
from taxel_models.loop.inference.contact_offset import FEWEST_FOR_SCATTER, ContactOffset
from taxel_models.loop.inference.correlated_reference import correlated_residual, correlated_structure
from taxel_models.loop.inference.kinds import all_forms, herfindahl, kind_columns, trained_kinds
from taxel_models.loop.inference.own_structure import OPEN, structure_of
from taxel_models.loop.inference.scoring import Progress, Scoring, silent
from taxel_models.loop.inference.stand_ins import without_their_kind
from taxel_models.loop.inference.whitening import Bins, NoiseShape
from taxel_models.loop.observations import Observations, gather
from taxel_models.model import Model
from taxel_models.recordings import Recording

KEPT: Final = 0.05
"""Blocks that the reference leaves out; the inference wants an evaluation part."""

MEAN: Final = 0.5
"""The confidence of a limit that is the mean."""

FEWEST_ROWS: Final = 2000
"""Of all recordings together, 20 s: fewer blocks leave open whether the model lacks anything at all."""

FEWEST_ROWS_OF_A_KIND: Final = 1000
"""10 s."""

FEWEST_KINDS: Final = 3
"""To tell how far kinds differ."""

DEVIATIONS: Final = 2.0
"""Standard deviations above the mean over kinds: what nearly all kinds stay below."""

FEWEST_FOR_MEAN: Final = 4
"""With fewer, blocks of a few seconds tell how far the mean error may lie."""


def held_out_residual(
    model: Model,
    recordings: Sequence[Recording],
    constants: Constants = DECLARED,
    progress: Progress | None = None,
) -> HeldOutResidual | None:
    """Of a model and the recordings that its training held out; None where they are too short.

    Args:
        constants: of the inference.
        progress: is told what is looked at.
    """
    progress = progress or silent
    try:
        observations = gather(model, recordings)
        if len(observations) < FEWEST_ROWS:
            return None
        blocks = cut(observations, seed=0, held_out=KEPT)
        correlated = correlated_residual(observations, blocks, constants, progress)
        found = _by_kind(observations, kind_columns(observations), correlated, constants, progress)
        new = {}
        for column in sorted(found.one_kind.keys() & trained_kinds(model.manifest).keys()):
            stand_ins = without_their_kind(observations, column)
            new[column] = _by_kind(stand_ins, [column], None, constants, lambda one: progress(f"new {one}"))
    except RecordingError:
        return None
    usual = tuple(usual_changes(observations, blocks).tolist())
    return found.model_copy(
        update={"sensitivity_change": usual, "correlated": correlated, "new_kinds": new}
    )


def _by_kind(
    observations: Observations,
    columns: Sequence[str],
    correlated: CorrelatedResidual | None,
    constants: Constants,
    progress: Progress,
) -> HeldOutResidual:
    """Of all rows together, and of one kind of each column that names enough of them."""
    found = _residual_of(observations, constants, progress)
    if len(np.unique(observations.contact)) < FEWEST_FOR_SCATTER:
        known = {name: own for name, own in found.structure.items() if name != ContactOffset.name}
        found = found.model_copy(update={"structure": known})
    kinds = {
        column: _residual_of_one_kind(observations, column, correlated, constants, progress)
        for column in columns
    }
    return found.model_copy(update={"one_kind": {column: own for column, own in kinds.items() if own}})


def _residual_of(
    observations: Observations,
    constants: Constants,
    progress: Progress,
    confidence: float = OPEN,
) -> HeldOutResidual:
    blocks = cut(observations, seed=0, held_out=KEPT)
    residual = observations.residual
    shape = NoiseShape.of(Bins.of(blocks, constants.bin_s), residual, constants.fading_s)
    found = HeldOutResidual(
        rows=len(observations),
        std=tuple(np.sqrt((residual**2).mean(axis=0)).tolist()),
        shared=tuple(shape.shared.tolist()),
        fading=tuple(shape.fading.tolist()),
    )
    effects = candidates(observations)
    scoring = Scoring(observations, blocks, effects, found, constants, progress)
    structure = structure_of(scoring, confidence)
    if Offset.name in structure:
        own = structure[Offset.name]
        gain = np.array(own.gain) + scoring.whitened_constant(_unknown_mean(observations, blocks))
        structure[Offset.name] = own.model_copy(update={"gain": tuple(gain.tolist())})
    return found.model_copy(update={"structure": structure})


def _residual_of_one_kind(
    observations: Observations,
    column: str,
    correlated: CorrelatedResidual | None,
    constants: Constants,
    progress: Progress,
) -> KindResidual | None:
    """Of a recording of one value of a column; None where fewer than three values have enough rows.

    There is little of each value, so all values together say how much one may show.
    """
    found, beside = [], []
    values = observations.covariates[column]
    kinds, rows = np.unique(values, return_counts=True)
    for kind in kinds[rows >= FEWEST_ROWS_OF_A_KIND]:
        progress(f"{column} {kind:g}")
        with suppress(RecordingError):
            own = observations.kept(values == kind)
            found.append(_residual_of(own, constants, silent, MEAN))
            if correlated is not None:
                blocks = cut(own, seed=0, held_out=KEPT)
                beside.append(correlated_structure(own, blocks, correlated, constants, MEAN))
    if len(found) < FEWEST_KINDS:
        return None
    std = np.sqrt(np.mean([np.square(one.std) for one in found], axis=0))
    return KindResidual(
        std=tuple(std.tolist()),
        structure=_of_nearly_all([one.structure for one in found]),
        herfindahl=herfindahl(values),
        correlated=_of_nearly_all(beside),
    )


def _of_nearly_all(kinds: Sequence[Mapping[str, OwnStructure]]) -> dict[str, OwnStructure]:
    """What nearly all kinds stay below, of each effect that enough of them tell of."""
    structure = {}
    for name in sorted({name for one in kinds for name in one}):
        figures = np.array([(one[name].log_evidence, one[name].gain) for one in kinds if name in one])
        if len(figures) >= FEWEST_KINDS:
            odds, gain = figures.mean(axis=0) + DEVIATIONS * figures.std(axis=0, ddof=1)
            structure[name] = OwnStructure(
                log_evidence=tuple(odds.tolist()),
                gain=tuple(gain.tolist()),
                forms=all_forms(name, kinds),
            )
    return structure


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
