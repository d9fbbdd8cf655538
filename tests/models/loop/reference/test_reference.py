"""A model's own held-out residual: what it gets wrong anyway is no effect of a sensor."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest
from scipy import stats

from taxel.channels import COUNTS_MAX
from taxel.held_out_residual import HeldOutResidual
from taxel.manifest import Manifest
from taxel_models.loop.attribution import AS_USUAL
from taxel_models.loop.blocks import cut
from taxel_models.loop.effects.effect import Effect
from taxel_models.loop.effects.gain import Gain
from taxel_models.loop.effects.hysteresis import Hysteresis
from taxel_models.loop.effects.lag import Lag
from taxel_models.loop.effects.offset import Offset
from taxel_models.loop.inference.constants import DECLARED
from taxel_models.loop.inference.scoring import Scoring
from taxel_models.loop.observations import gather
from taxel_models.loop.pipeline import LoopSettings, run_loop
from taxel_models.loop.reference.gain_limit import times_for_few
from taxel_models.loop.reference.held_out import KEPT, held_out_residual
from taxel_models.loop.reference.own_structure import MEAN, ONE_ERROR, OPEN, own_gain, own_residual
from taxel_models.loop.report.wording import anyway, no_reference
from taxel_models.recordings import Recording
from taxel_models.recovery.injection import Injection
from taxel_models.recovery.injectors import inject

Make = Callable[..., Recording]


def with_effect(make: Make, name: str, seed: int, *, draw: int = 9, strength: float = 1.0) -> Recording:
    """A recording with an effect; the same `draw` gives the same effect in another one."""
    injection = Injection.into(make(6_000, seed=seed), draw, np.full(21, 6.0))
    inject(injection, name, strength)
    return injection.recording


@pytest.fixture(scope="module")
def make(make: Make) -> Make:
    """Recordings without materials: each would be compared by itself, which takes most of the time."""
    return partial(make, materials=False)


@pytest.fixture(scope="module")
def reference(smooth: Any, make: Make) -> HeldOutResidual:
    found = held_out_residual(smooth, [make(seed=8)])
    assert found is not None
    return found


@pytest.fixture(scope="module")
def lacks(smooth: Any, make: Make) -> HeldOutResidual:
    """Of a model that lacks hysteresis."""
    found = held_out_residual(smooth, [with_effect(make, "hysteresis", 8)])
    assert found is not None
    return found


@pytest.fixture(scope="module")
def scattered(smooth: Any, make: Make) -> HeldOutResidual:
    """Of contacts that scatter."""
    found = held_out_residual(smooth, [apart(make)])
    assert found is not None
    return found


def test_it_is_the_residual_of_noise_for_a_model_that_lacks_nothing(reference: HeldOutResidual) -> None:
    assert reference.rows == 9_000 - 20
    # Counts are whole, and the noise's standard deviation is 4.
    np.testing.assert_allclose(reference.std, np.sqrt(16 + 1 / 12), rtol=0.05)
    assert max(reference.shared) <= 0.1
    assert np.mean(reference.fading) <= 0.1


def test_it_says_what_every_effect_explains_of_it(reference: HeldOutResidual) -> None:
    assert {"offset", "gain", "drift", "creep", "lag", "location"} <= set(reference.structure)
    for own in reference.structure.values():
        assert len(own.log_evidence) == len(own.gain) == 21
        assert max(own.gain) < 0.1 * 16


def test_a_manifest_keeps_it(smooth: Any, reference: HeldOutResidual) -> None:
    manifest = smooth.manifest.model_copy(update={"held_out_residual": reference})
    assert Manifest.model_validate_json(manifest.model_dump_json()) == manifest


def test_there_is_none_of_recordings_that_are_too_short(smooth: Any, make: Make) -> None:
    assert held_out_residual(smooth, [make(15)]) is None
    assert held_out_residual(smooth, [make(900)]) is None


def test_the_same_structure_in_new_recordings_is_not_named(
    smooth: Any, make: Make, lacks: HeldOutResidual
) -> None:
    again = with_effect(make, "hysteresis", 4)
    alone = run_loop(smooth, [again], LoopSettings()).findings
    assert [effect.name for effect in alone.effects] == ["hysteresis"]
    known = run_loop(smooth, [again], LoopSettings(), reference=lacks).findings
    assert known.effects == ()


def test_other_effects_are_named_beside_what_is_known(
    smooth: Any, make: Make, lacks: HeldOutResidual
) -> None:
    injection = Injection.into(with_effect(make, "hysteresis", 4), 3, np.full(21, 12.0))
    inject(injection, "offset", 1.0)
    findings = run_loop(smooth, [injection.recording], LoopSettings(), reference=lacks).findings
    assert [effect.name for effect in findings.effects] == ["offset"]


def late(recording: Recording, ticks: int) -> Recording:
    """Its channels come so many ticks late."""
    rows = np.maximum(np.arange(len(recording)) - ticks, 0)
    return replace(recording, channels=recording.channels[rows])


def test_a_delay_that_the_model_never_had_is_named_beside_one_that_it_had(smooth: Any, make: Make) -> None:
    """Its clocks were apart by 20 ms from the start: that says nothing of 60 ms."""
    known = held_out_residual(smooth, [late(make(seed=8), 2)])
    assert known is not None
    assert "20 ms" in known.structure["lag"].forms
    assert not {"-20 ms", "60 ms"} & set(known.structure["lag"].forms)
    assert known.correlated is not None
    assert known.correlated.structure["lag"].has("20 ms")
    assert not known.correlated.structure["lag"].has("60 ms")
    assert known.structure["creep"].forms == ()

    def named(ticks: int) -> list[tuple[str, str]]:
        result = run_loop(smooth, [late(make(seed=9), ticks)], LoopSettings(), reference=known)
        return [(effect.name, effect.form) for effect in result.findings.effects]

    assert named(2) == []
    assert named(6) == [("lag", "60 ms")]


def test_where_the_residual_is_smaller_so_is_what_is_usual_of_it(
    smooth: Any, make: Make, lacks: HeldOutResidual
) -> None:
    larger = {
        name: own.model_copy(update={"gain": tuple(9.0 * gain for gain in own.gain)})
        for name, own in lacks.structure.items()
    }
    update = {"std": tuple(3.0 * std for std in lacks.std), "structure": larger}
    recording = with_effect(make, "gain", 4)
    # A force sensor's gain does nearly the same.
    settings = LoopSettings(exclude=("frame",))
    for reference in (lacks, lacks.model_copy(update=update)):
        findings = run_loop(smooth, [recording], settings, reference=reference).findings
        assert [effect.name for effect in findings.effects] == ["gain"]


def apart(make: Make, rows: int = 300) -> Recording:
    """Contacts of a sensor that scatter more than the model's own errors do."""
    random = np.random.default_rng(1)
    recording = make(9_000, seed=2)
    contact = np.arange(len(recording)) // rows
    scattered = recording.channels + (random.normal(size=(30, 21)) * 12.0)[contact]
    return replace(
        recording,
        samples=replace(recording.samples, time_ns=recording.samples.time_ns + 1_000_000_000 * contact),
        channels=np.clip(np.rint(scattered), 0, 4095),
    )


def scoring_of(
    smooth: Any, recording: Recording, effects: Sequence[Effect], reference: HeldOutResidual
) -> Scoring:
    """Of a recording, whose blocks are as a reference has them."""
    observations = gather(smooth, [recording])
    blocks = cut(observations, seed=0, held_out=KEPT)
    return Scoring(observations, blocks, effects, reference, DECLARED, lambda _: None)


def squared_counts(scoring: Scoring) -> Any:
    """(21,) a gain of 1 while nothing is named, counts²."""
    return scoring.bases([]).plain.noise * scoring.whitening.scale**2


def test_nothing_is_left_of_what_is_known_of_the_same_recording(
    smooth: Any, make: Make, scattered: HeldOutResidual
) -> None:
    """What each effect takes off is kept in the units in which it is subtracted."""
    recording = apart(make)
    effects = [Offset(), Gain(), Hysteresis()]
    without = scattered.model_copy(update={"structure": {}})
    gains = {}
    for name, reference in {"unknown": without, "known": scattered}.items():
        scoring = scoring_of(smooth, recording, effects, reference)
        unit = squared_counts(scoring)
        gains[name] = {score.name: score.gain.sum(axis=0) * unit for score in scoring.scores([])}
    assert set(gains["unknown"]) == {"offset", "gain", "hysteresis", "offset:contact"}
    assert gains["unknown"]["offset:contact"].min() > 100
    # They count up to one standard error of what so few contacts tell.
    left, known_gain = gains["known"]["offset:contact"], gains["unknown"]["offset:contact"]
    assert left.sum() < 0.0
    assert (left + known_gain).min() > 0.0
    # The form of another effect may be another one where its evidence is known.
    assert max(taken_off.sum() for taken_off in gains["known"].values()) < 1e-3


def test_without_it_what_the_model_got_wrong_from_the_start_is_named(smooth: Any, make: Make) -> None:
    reference = held_out_residual(smooth, [with_effect(make, "rate", 8, strength=2.0)])
    recording = with_effect(make, "rate", 9, strength=2.0)
    known = run_loop(smooth, [recording], LoopSettings(), reference=reference).findings
    assert not known.effects
    (rate,) = [one for one in known.rejected if one.name == "rate"]
    assert rate.reason == AS_USUAL
    (sentence,) = anyway(known)
    assert "rate" in sentence
    named = run_loop(smooth, [recording], LoopSettings(reference=False), reference=reference).findings
    assert [effect.name for effect in named.effects] == ["rate"]
    assert anyway(named) == no_reference(named) == []
    unknown = run_loop(smooth, [recording], LoopSettings()).findings
    assert "rate" in [effect.name for effect in unknown.effects]
    (sentence,) = no_reference(unknown)
    assert "may be its own misfit" in sentence
    with_reference = {**unknown.split, "reference_rows": 9_000}
    assert no_reference(unknown.model_copy(update={"split": with_reference})) == []


def test_a_manifests_own_is_used(smooth: Any, make: Make, reference: HeldOutResidual) -> None:
    recording = apart(make)

    class Known:
        manifest = smooth.manifest.model_copy(update={"held_out_residual": reference})
        predict = staticmethod(smooth.predict)
        predict_base = staticmethod(smooth.predict_base)

    findings = run_loop(Known(), [recording], LoopSettings()).findings
    (effect,) = findings.effects
    assert effect.name == "offset:contact"
    assert not effect.served
    assert effect.explained > 0.7
    assert findings.after == findings.before
    # Without the reference, nobody knows how much contacts scatter anyway.
    unknown = run_loop(smooth, [recording], LoopSettings()).findings
    assert "offset:contact" not in {effect.name for effect in unknown.effects}
    (rejected,) = (one for one in unknown.rejected if one.name == "offset:contact")
    assert rejected.reason.endswith("expected a model that was exported with 8 contacts")


def test_a_delay_must_lower_the_error_of_single_rows(
    smooth: Any, make: Make, reference: HeldOutResidual
) -> None:
    scoring = scoring_of(smooth, late(make(seed=4), 2), [Lag()], reference)
    score = next(score for score in scoring.scores([]) if score.name == "lag")
    raises = {
        form.candidate.form: scoring.raises_single_rows(replace(score, form=form), [])
        for form in scoring.forms_of(Lag())
    }
    assert {"10 ms", "20 ms", "30 ms"}.isdisjoint(form for form, worse in raises.items() if worse)
    assert raises["-20 ms"]
    assert raises["80 ms"]


@pytest.mark.parametrize("contacts", [8, 20])
def test_what_few_known_contacts_have_is_not_named_in_others(
    smooth: Any, make: Make, contacts: int
) -> None:
    known = held_out_residual(smooth, [apart(make).rows(np.arange(9_000) < 300 * contacts)])
    assert known is not None
    assert "offset:contact" in known.structure
    found = run_loop(smooth, [apart(make)], LoopSettings(), reference=known).findings
    assert [effect.name for effect in found.effects] == []


@pytest.mark.parametrize(("contacts", "named"), [(7, []), (8, ["offset:contact"])])
def test_too_few_contacts_do_not_tell_how_far_their_offsets_scatter(
    smooth: Any, make: Make, contacts: int, named: list[str]
) -> None:
    some = always_pressed(smooth, apart(make, 600)).rows(np.arange(9_000) < 600 * contacts)
    known = held_out_residual(smooth, [some])
    assert known is not None
    assert ("offset:contact" in known.structure) is bool(named)
    found = run_loop(smooth, [apart(make)], LoopSettings(), reference=known).findings
    assert [effect.name for effect in found.effects if effect.name == "offset:contact"] == named
    unknown = {one.name for one in found.rejected if "is not known" in one.reason}
    assert ("offset:contact" in unknown) is not bool(named)


def always_pressed(smooth: Any, recording: Recording) -> Recording:
    """With one touch in each segment, and noise."""
    force = np.full_like(recording.samples.force, -1.0)
    noise = np.random.default_rng(6).normal(size=recording.channels.shape) * 10.0
    channels = np.clip(np.rint(smooth.counts(recording.samples.position, force) + noise), 0, COUNTS_MAX)
    return replace(recording, samples=replace(recording.samples, force=force), channels=channels)


def test_the_fewer_contacts_are_known_the_more_is_usual(
    smooth: Any, make: Make, scattered: HeldOutResidual
) -> None:
    nothing = scattered.model_copy(update={"structure": {}})
    scoring = scoring_of(smooth, apart(make), [Offset()], nothing)
    (score,) = (score for score in scoring.scores([]) if score.name == "offset:contact")
    own = np.maximum(own_gain(scoring, score), 0.0) / len(scoring.bins)
    np.testing.assert_allclose(scattered.structure["offset:contact"].gain, times_for_few(29, OPEN) * own)


def test_what_few_contacts_leave_open_of_their_mean_counts_in_a_limit_alone(
    smooth: Any, make: Make
) -> None:
    """A mean over kinds has it already: the means of their few contacts scatter by as much."""
    observations = gather(smooth, [apart(make).rows(np.arange(9_000) < 300 * 8)])
    known = {
        confidence: own_residual(observations, DECLARED, lambda _: None, confidence)
        for confidence in (MEAN, OPEN)
    }
    scoring = scoring_of(smooth, apart(make), [Offset()], known[MEAN])
    unit = scoring.whitened_constant(np.ones(21))
    size = {one: np.sqrt(own.structure["offset"].gain / unit) for one, own in known.items()}
    mean = np.abs(observations.residual.mean(axis=0))
    assert np.median(size[MEAN]) == pytest.approx(np.median(mean), rel=0.3)
    by_contact = np.array(
        [observations.residual[observations.contact == one].mean(axis=0) for one in range(8)]
    )
    left_open = stats.t.ppf(0.975, 7) * by_contact.std(axis=0, ddof=1) / np.sqrt(8)
    assert (size[OPEN] > left_open).all()


def test_a_calibration_that_makes_it_worse_leaves_open_how_much_is_usual(
    smooth: Any, make: Make, scattered: HeldOutResidual
) -> None:
    """One odd contact can cost more than all others gain. That says little, not that nothing is usual."""
    scoring = scoring_of(smooth, apart(make), [Offset()], scattered)
    (score,) = (score for score in scoring.scores([]) if score.name == "offset:contact")
    unit = squared_counts(scoring)
    gain = np.full_like(score.gain, 5.0)
    gain[0] = -10.0 * len(gain)
    worse = replace(score, gain=gain)
    assert gain.sum() < 0
    scatter = gain.std(axis=0, ddof=1) * np.sqrt(len(gain))
    limit = float(stats.t.ppf(ONE_ERROR, len(gain) - 1))
    np.testing.assert_allclose(own_gain(scoring, worse), unit * (gain.sum(axis=0) + limit * scatter))
    assert own_gain(scoring, worse).min() > 0
