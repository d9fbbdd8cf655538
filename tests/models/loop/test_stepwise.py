"""Which effect the selection names, and which it keeps."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from taxel_models.loop.cross_validation import Score
from taxel_models.loop.model_selection import CONTENDER_LEVEL, FOLD_LEVEL
from taxel_models.loop.stepwise import StepwiseSelection

from taxel.channels import CHANNELS
from taxel_models.loop.blocks import cut
from taxel_models.loop.effects.registry import candidates
from taxel_models.loop.observations import Observations, gather
from taxel_models.loop.pipeline import LoopSettings, run_loop
from taxel_models.recordings import Recording
from taxel_models.recovery.injection import Injection
from taxel_models.recovery.injectors import inject

Make = Callable[..., Recording]


@pytest.fixture
def offset(smooth: Any, make: Make) -> Observations:
    """A recording with an offset of three times its noise."""
    injection = Injection.into(make(), 2, np.full(21, 12.0))
    inject(injection, "offset", 1.0)
    return gather(smooth, [injection.recording], measured_temperature=True)


def unclear(one: Score) -> Score:
    """As much of the residual, but in a few folds."""
    folds = np.array([8.0, *np.zeros(7)])
    by_channel = one.channel_share.mean(axis=0)
    return replace(one, fold_share=one.share * folds, channel_share=folds[:, None] * by_channel)


def test_the_better_explanation_is_named_though_another_repeats_more_clearly(offset: Observations) -> None:
    selection = StepwiseSelection(offset, cut(offset, seed=0), candidates(offset), seed=0)
    scores = selection.scores(offset.measured - offset.predicted)
    (best,) = [one for one in scores if one.candidate.effect == "offset"]
    (other,) = [one for one in scores if one.candidate.effect == "gain"]
    # The same regressors under another name, of which a tenth is left.
    weak = replace(
        other,
        candidate=replace(best.candidate, effect="gain", form="a tenth"),
        statistics=replace(best.statistics, cross=0.3 * best.statistics.cross),
        share=0.1 * best.share,
        fold_share=np.full(8, 0.1 * best.share),
        channel_share=np.full((8, 21), 0.1 * best.share),
    )
    sure = {"offset": 0.005, "gain": 0.005}
    assert unclear(best).repeats > FOLD_LEVEL > weak.repeats
    named = selection.best([unclear(best), weak], sure)
    assert named is not None
    assert named.candidate.effect == "offset"
    assert selection.best([unclear(best)], sure) is None
    assert selection.best([best], {"offset": CONTENDER_LEVEL}) is None
    # Once the other stands out, less is asked of what explains more, but not nothing.
    for p_value, taken in ((CONTENDER_LEVEL, "offset"), (2 * CONTENDER_LEVEL, "gain")):
        named = selection.best([best, weak], {"offset": p_value, "gain": 0.005})
        assert named is not None
        assert named.candidate.effect == taken


def test_a_certain_cause_is_named_before_one_that_explains_more(smooth: Any, make: Make) -> None:
    injection = Injection.into(make(), 2, np.full(21, 12.0))
    inject(injection, "offset", 2.0)
    counts = injection.recording.channels.copy()
    counts[:, 7] = 2000.0
    injection.replace_channels(replace(injection.recording, channels=counts))
    seen = gather(smooth, [injection.recording], measured_temperature=True)
    selection = StepwiseSelection(seen, cut(seen, seed=0), candidates(seen), seed=0)
    scores = selection.scores(seen.measured - seen.predicted)
    (fault,) = [one for one in scores if one.candidate.effect == "fault"]
    assert fault.share < 0.5 * max(one.share for one in scores)
    named = selection.best(scores, {one.candidate.effect: 0.005 for one in scores})
    assert named is fault
    found = {one.name: one for one in selection.run().named}
    assert found["fault"].channels == (CHANNELS[7],)
    assert found["fault"].confounded_with == ()
    assert "offset" in found


def test_a_form_whose_weights_contradict_its_cause_is_not_named(offset: Observations) -> None:
    selection = StepwiseSelection(offset, cut(offset, seed=0), candidates(offset), seed=0)
    scores = selection.scores(offset.measured - offset.predicted)
    (best,) = [one for one in scores if one.candidate.effect == "offset"]
    sure = {"offset": 0.005}
    for alike, named in ((100.0, True), (0.01, False)):
        one = replace(best, candidate=replace(best.candidate, alike=alike))
        assert (selection.best([one], sure) is one) == named


def test_why_a_contradiction_was_not_named_is_said(smooth: Any, make: Make) -> None:
    injection = Injection.into(make(12_000), 2, np.full(21, 12.0))
    clock = injection.time_s - injection.time_s.mean()
    injection.begin("drift", 2.0)
    injection.add(clock[:, None] * np.linspace(-1.0, 3.0, 21), {"amplitude": np.ones(21)})
    # The twin's tdc rises with the clock, so that a temperature would explain it as well.
    findings = run_loop(smooth, [injection.recording], LoopSettings(exclude=("drift", "gain"))).findings
    assert "temperature" not in {effect.name for effect in findings.effects}
    (temperature,) = [one for one in findings.rejected if one.name == "temperature"]
    assert temperature.reason == "stands out, but its weights differ more than its cause allows"


@pytest.mark.parametrize(("least_share", "kept"), [(0.003, True), (0.02, False)])
def test_a_small_effect_stays_where_it_is_asked_for(
    smooth: Any, make: Make, least_share: float, kept: bool
) -> None:
    injection = Injection.into(make(20_000), 2, np.full(21, 12.0))
    inject(injection, "offset", 1.0)
    inject(injection, "hysteresis", 0.06)
    settings = LoopSettings(least_share=least_share)
    findings = run_loop(smooth, [injection.recording], settings).findings
    assert findings.effects[0].name == "offset"
    assert ("hysteresis" in {effect.name for effect in findings.effects}) == kept


def test_places_are_those_of_the_window_that_a_lag_chose(observations: Observations) -> None:
    (location,) = [one for one in candidates(observations) if one.label == "location"]
    selection = StepwiseSelection(observations, cut(observations, seed=0), [location], seed=0)
    late = observations.with_windows(
        observations.windows[observations.rows_before(8)], turn=observations.turn, shift_ticks=8
    )
    (form,) = [one.candidate for one in selection.scores(observations.measured - observations.predicted)]
    assert form.again is not None
    weights = np.ones((len(CHANNELS), form.basis.size))
    before, after = form.basis.times(weights), form.again(late).basis.times(weights)
    np.testing.assert_allclose(after, before[observations.rows_before(8)], rtol=1e-12)
