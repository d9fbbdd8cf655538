"""What a recording cannot show: counts beyond their limits, and kinds that nothing is fitted to."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from taxel_models.loop.attribution import Attribution
from taxel_models.loop.blocks import Blocks, cut
from taxel_models.loop.effects.registry import candidates
from taxel_models.loop.inference.constants import DECLARED
from taxel_models.loop.inference.scoring import Scoring
from taxel_models.loop.inference.selection import JointSelection
from taxel_models.loop.observations import gather
from taxel_models.loop.status import silent
from taxel_models.recordings import Recording

from .tared import Tared, with_counts

Make = Callable[..., Recording]
ROWS = 12_000


def attributed(smooth: Any, recording: Recording, *names: str) -> tuple[Attribution, Blocks]:
    """With only some effects that compete."""
    observations = gather(smooth, [recording])
    effects = [effect for effect in candidates(observations) if effect.label in names]
    blocks = cut(observations, seed=0)
    return JointSelection(observations, blocks, effects).run(), blocks


@pytest.mark.parametrize("slope", [-4.0, -8.0])
def test_an_effect_that_leads_beyond_a_limit_is_still_found(smooth: Any, make: Make, slope: float) -> None:
    """Counts that are cut off fit no line: the fold that holds the most of them speaks against it."""
    model, recording = Tared(smooth, share=0.2), make(ROWS, seed=4)
    amount = np.repeat(np.random.default_rng(5).normal(size=ROWS // 500), 500)
    amount[3_000:3_500] = 12.0
    recording = replace(recording, covariates={"load": amount + 0.001 * np.arange(ROWS) / ROWS})
    counts = model.of_size(recording.channels)
    effect = slope * (amount - amount.mean())[:, None]
    cut_off = with_counts(recording, counts + effect)
    found, _ = attributed(model, cut_off, "covariate:load", "offset", "gain", "drift")
    assert [one.name for one in found.named][:1] == ["covariate:load"]


def test_predictions_prove_nothing_where_no_counts_are_cut_off(smooth: Any, make: Make) -> None:
    """They take rows for independent. Here, a gain is made to contradict itself over the folds."""
    recording = make(ROWS, seed=4)
    rest = smooth.counts(np.zeros((1, 3)), np.zeros((1, 3)))
    observations = gather(smooth, [with_counts(recording, rest + 1.2 * (recording.channels - rest))])
    blocks, effects = cut(observations, seed=0), candidates(observations)
    gain = [effect for effect in effects if effect.label == "gain"]
    scoring = Scoring(observations, blocks, gain, None, DECLARED, silent)
    (score,) = scoring.scores([])
    free, within = scoring.by_predictions(score, [])
    np.testing.assert_array_equal(free.gain, within.gain)
    doubtful = replace(score, gain=score.gain * np.resize([1.0, -1.0], len(score.gain))[:, None])
    assert within.t > DECLARED.least_t(within.folds) > doubtful.t_with_usual
    assert JointSelection(observations, blocks, gain).proven_by_limits([doubtful]) is None


def with_a_kind_held_out(smooth: Any, recording: Recording) -> Recording:
    """Some blocks of the evaluation part, and no others, are of kind 9."""
    observations = gather(smooth, [recording])
    held = cut(observations, seed=0).evaluation
    kinds = recording.covariates["material"].copy()
    (rows,) = observations.rows
    kinds[rows[held]] = np.where(rows[held] < ROWS // 3, 9.0, kinds[rows[held]])
    return replace(recording, covariates={"material": kinds})


def left_of(smooth: Any, recording: Recording, found: Attribution, blocks: Blocks) -> tuple[float, float]:
    """The share of the squared error that is left, of kind 9 and of the rest of the evaluation part."""
    observations = gather(smooth, [recording])
    before = observations.residual**2
    after = (observations.residual - sum(one.contribution for one in found.named)) ** 2
    kinds = recording.covariates["material"][observations.rows[0]]
    unknown, others = blocks.evaluation & (kinds == 9.0), blocks.evaluation & (kinds != 9.0)
    assert unknown.any()
    return after[unknown].mean() / before[unknown].mean(), after[others].mean() / before[others].mean()


def test_a_kind_that_nothing_was_fitted_to_gets_no_gain(smooth: Any, make: Make) -> None:
    recording = with_a_kind_held_out(smooth, make(ROWS, seed=6))
    kinds = recording.covariates["material"]
    gains = np.array([0.0, -0.3, -0.1, -0.2, -0.4, -0.15, 0.0, 0.0, 0.0, -0.25])[kinds.astype(int)]
    rest = smooth.counts(np.zeros((1, 3)), np.zeros((1, 3)))
    recording = with_counts(recording, recording.channels + gains[:, None] * (recording.channels - rest))
    found, blocks = attributed(smooth, recording, "covariate:material", "gain", "offset")
    assert "covariate:material" in [one.name for one in found.named]
    names = [name for one in found.named for name in one.candidate.weight_names]
    assert "material=9" not in names
    unknown, others = left_of(smooth, recording, found, blocks)
    assert unknown <= 1.0
    assert others <= 0.2


@pytest.mark.parametrize("common", [0.0, 20.0])
def test_a_kind_that_nothing_was_fitted_to_gets_no_constant(smooth: Any, make: Make, common: float) -> None:
    """What all kinds share is no kind's constant, also where nothing else may be named."""
    recording = with_a_kind_held_out(smooth, make(ROWS, seed=6))
    constants = np.random.default_rng(3).normal(size=(10, 21)) * 12.0 + common
    kinds = recording.covariates["material"].astype(int)
    recording = with_counts(recording, recording.channels + constants[kinds])
    found, blocks = attributed(smooth, recording, "covariate:material")
    assert [one.name for one in found.named] == ["covariate:material"]
    unknown, others = left_of(smooth, recording, found, blocks)
    assert unknown < 1.1
    assert others < 0.9
