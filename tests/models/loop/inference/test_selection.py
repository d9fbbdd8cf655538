"""Which effects are named in small recordings with known causes."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from taxel.channels import CHANNELS
from taxel.windows import Relaxation, Warmth
from taxel_models.loop.blocks import cut
from taxel_models.loop.effects.effect import Remaining
from taxel_models.loop.effects.registry import candidates
from taxel_models.loop.inference.constants import DECLARED
from taxel_models.loop.inference.forms import prepared
from taxel_models.loop.inference.outcome import Outcome
from taxel_models.loop.inference.score import Taken
from taxel_models.loop.inference.selection import JointSelection
from taxel_models.loop.inference.whitening import Bins, NoiseShape, Whitening
from taxel_models.loop.observations import Observations, gather
from taxel_models.loop.pipeline import LoopSettings, run_loop
from taxel_models.loop.reference.held_out import held_out_residual
from taxel_models.recordings import Recording
from taxel_models.recovery.injection import Injection
from taxel_models.recovery.injectors import inject

from .selected import ROWS, Make, add, attributed, into, names, only

pytestmark = pytest.mark.usefixtures("quick_references")


@pytest.mark.parametrize("seed", range(4))
def test_nothing_is_named_where_nothing_was_injected(smooth: Any, make: Make, seed: int) -> None:
    found = attributed(smooth, make(ROWS, seed=20 + seed))
    assert found.named == ()
    np.testing.assert_array_equal(found.residual, found.observations.residual)


def test_an_offset_is_measured(smooth: Any, make: Make) -> None:
    injection = into(make)
    offsets = np.round(np.linspace(-20.0, 25.0, 21))
    add(injection, offsets[None])
    found = only(attributed(smooth, injection.recording))
    assert (found.name, found.candidate.form) == ("offset", "constant")
    np.testing.assert_allclose(found.weights[:, 0], offsets, atol=0.5)
    assert found.log_evidence > 100
    assert found.p_value < DECLARED.chance


def test_a_gain_that_all_channels_share_is_one_figure(smooth: Any, make: Make) -> None:
    injection = into(make)
    add(injection, 0.15 * injection.signal)
    found = only(attributed(smooth, injection.recording))
    assert (found.name, found.candidate.form) == ("gain", "all channels alike")
    np.testing.assert_allclose(found.weights, 0.15, atol=0.01)


def test_a_skin_that_wears_is_one_figure_of_the_electrodes(smooth: Any, make: Make) -> None:
    """The pressure sensor answers as before."""
    injection = into(make)
    delta = -0.2 * injection.signal
    delta[:, :2] = 0.0
    add(injection, delta)
    found = only(attributed(smooth, injection.recording))
    assert (found.name, found.candidate.form) == ("gain", "all electrodes alike")
    np.testing.assert_allclose(found.weights[2:], -0.2, atol=0.01)
    assert (found.weights[:2] == 0.0).all()


@pytest.mark.parametrize("course", ["line", "step"])
def test_a_drift_that_begins_at_0_brings_no_offset(smooth: Any, make: Make, course: str) -> None:
    injection = into(make, 9_000)
    share = np.linspace(0.0, 1.0, 9_000) if course == "line" else (np.arange(9_000) >= 5_000) * 1.0
    delta = share[:, None] * 30.0 * np.resize([1.0, -1.0, 0.5, -0.6], 21)
    add(injection, delta)
    found_all = attributed(smooth, injection.recording)
    found = only(found_all)
    assert found.name == "drift"
    rows = found_all.observations.rows[0]
    # A step is placed between blocks, or in the middle of one that is held out.
    off = np.abs(found.contribution - delta[rows]).mean(axis=1)
    assert np.median(off) < 3.0
    assert found.contribution[0] == pytest.approx(np.zeros(21), abs=1.5)


def test_a_step_is_in_the_middle_of_rows_that_tell_nothing(observations: Observations) -> None:
    fit = np.ones(len(observations), np.bool_)
    fit[2_000:3_000] = False
    (drift,) = [effect for effect in candidates(observations) if effect.label == "drift"]
    forms = drift.forms(observations, Remaining(observations.residual, fit, np.ones(len(fit))))
    told = np.array([form.form_parameters["time"][0] for form in forms if "time" in form.form_parameters])
    time = observations.time_s
    inside = told[(told > time[1_999]) & (told < time[3_000])]
    np.testing.assert_allclose(inside, 0.5 * (time[1_999] + time[3_000]), atol=0.01)
    assert len(inside) > 0
    assert len(told) > 20


def test_one_electrodes_gain_is_told(smooth: Any, make: Make) -> None:
    injection = into(make)
    delta = np.zeros_like(injection.recording.channels)
    delta[:, 9] = 0.25 * injection.signal[:, 9]
    add(injection, delta)
    found = only(attributed(smooth, injection.recording))
    assert (found.name, found.candidate.form) == ("gain", "by channel")
    assert found.included[9] > 0.99
    assert np.delete(found.included, 9).max() < 0.9
    assert found.weights[9, 0] == pytest.approx(0.25, abs=0.02)
    assert CHANNELS[9] in found.channels


def creep(injection: Injection, tau: float = 3.0) -> np.ndarray:
    """(n, 21) counts, 12 in the mean square of each channel, of signs that alternate."""
    past = injection.history(Relaxation(of="force", time_constant_s=tau))
    return 12.0 * past[:, None] / np.sqrt((past**2).mean()) * np.resize([1.0, -1.2, 0.7], 21)


def test_a_creep_whose_mean_the_model_absorbed_is_named_without_an_offset(smooth: Any, make: Make) -> None:
    injection = into(make, 9_000)
    delta = creep(injection)
    add(injection, delta - delta.mean(axis=0))
    found_all = attributed(smooth, injection.recording)
    found = only(found_all)
    assert found.name == "creep"
    assert found.candidate.form_parameters["time_constant"][0] == pytest.approx(3.0, rel=0.2)
    rows = found_all.observations.rows[0]
    np.testing.assert_allclose(found.contribution, (delta - delta.mean(axis=0))[rows], atol=4.0)


def test_an_offset_beside_a_creep_is_named_too(smooth: Any, make: Make) -> None:
    injection = into(make, 9_000)
    offsets = 15.0 * np.resize([1.0, -1.0, 0.5, -0.6], 21)
    delta = creep(injection)
    add(injection, delta + offsets)
    found = attributed(smooth, injection.recording)
    assert set(names(found)) == {"offset", "creep"}
    added = np.sum([one.contribution for one in found.named], axis=0)
    np.testing.assert_allclose(added, (delta + offsets)[found.observations.rows[0]], atol=4.0)


def test_a_skin_that_contact_warms_is_told_from_creep_by_its_electrodes_that_move_alike(
    smooth: Any, make: Make
) -> None:
    injection = into(make, 12_000)
    warmth = injection.history(Warmth(of="force", warming_s=7.0, cooling_s=20.0))
    counts = injection.recording.channels
    slopes = -0.05 * (1.0 + 0.2 * np.cos(np.arange(21))) * (np.arange(21) >= 2)
    # d counts / d ln Z of the converter is -E (4095 - E) / 4095.
    delta = -counts * (4095.0 - counts) / 4095.0 * slopes * (warmth - warmth.mean())[:, None]
    add(injection, delta)
    found = only(attributed(smooth, injection.recording))
    assert found.name == "temperature"
    assert found.candidate.form.startswith("contact warms")
    assert found.weights[5, 0] == pytest.approx(-0.05, rel=0.5)


def cut_off(make: Make) -> tuple[Recording, float]:
    """A recording with offsets that lead one channel below 0 at times, and that channel's offset."""
    injection = into(make)
    offsets = np.full(21, -12.0)
    offsets[5] = -np.round(np.quantile(injection.recording.channels[:, 5], 0.3))
    add(injection, offsets[None])
    assert 0.2 < (injection.recording.channels[:, 5] == 0).mean() < 0.4
    return injection.recording, float(offsets[5])


def test_a_channel_at_a_limit_of_the_counts_does_not_hide_an_offset(smooth: Any, make: Make) -> None:
    recording, offset = cut_off(make)
    found = attributed(smooth, recording, exclude=("fault",))
    assert names(found) == ["offset"]
    # A weight is shrunk by its prior, here by 1 %.
    assert found.named[0].weights[5, 0] == pytest.approx(offset, rel=0.02)


def test_a_channel_at_a_limit_of_the_counts_is_no_fault(smooth: Any, make: Make) -> None:
    assert names(attributed(smooth, cut_off(make)[0])) == ["offset"]


def test_what_single_rows_show_nothing_of_is_not_named(
    smooth: Any, make: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    injection = into(make)
    for effect in ("offset", "gain"):
        inject(injection, effect, 1.0)
    assert {"offset", "gain"} <= set(names(attributed(smooth, injection.recording)))
    fitted_to_rows = Outcome.fitted_to_rows

    def of_no_gain(outcome: Outcome, taken: Sequence[Taken]) -> list[Taken]:
        return [
            replace(one, contribution=0.0 * one.contribution) if one.name == "gain" else one
            for one in fitted_to_rows(outcome, taken)
        ]

    monkeypatch.setattr(Outcome, "fitted_to_rows", of_no_gain)
    found = names(attributed(smooth, injection.recording))
    assert "offset" in found
    assert "gain" not in found


def test_positions_of_a_robot_are_no_places_on_a_skin(smooth: Any, make: Make) -> None:
    recording = make(ROWS)
    # The model takes none of the positions' shift, so that the predictions stay.
    observations = gather(smooth, [recording])
    away = observations.position * 20.0
    far = replace(observations, position=away)
    effects = candidates(far)
    found = JointSelection(far, cut(far, seed=0), effects).run()
    (location,) = [one for one in found.rejected if one.name == "location"]
    assert "poses of a robot" in location.reason
    assert (location.log_evidence, location.p_value) == (0.0, 1.0)


def test_a_lag_and_a_turned_frame_are_both_found(smooth: Any, make: Make) -> None:
    injection = into(make, 9_000)
    injection.respond = smooth.counts
    inject(injection, "frame", 2.0)
    recording = injection.recording
    late = np.maximum(np.arange(len(recording)) - 5, 0)
    injection.recording = replace(recording, channels=recording.channels[late])
    found = attributed(smooth, injection.recording)
    assert set(names(found)) == {"lag", "frame"}
    assert found.observations.shift_ticks == 5
    (frame,) = [one for one in found.named if one.name == "frame"]
    assert frame.candidate.moves
    assert np.sqrt((found.residual**2).mean()) < 1.3 * 4.0


def slipped(recording: Recording) -> Recording:
    """With forces that turn by 25 degrees from 36 to 45 s."""
    seconds = np.arange(len(recording)) / 100
    course = np.clip((seconds - 36.0) / 9.0, 0.0, 1.0)
    turn = np.radians(25.0) * course[:, None] * np.array([0.6, 0.0, 0.8])
    force = Rotation.from_rotvec(turn).apply(recording.samples.force)
    return replace(recording, samples=replace(recording.samples, force=force))


@pytest.mark.parametrize(
    ("shift", "scale", "form", "parameters"),
    [
        ((0.5, -0.4, 0.3), 1.0, "forces shifted", {"force x": -0.5, "force y": 0.4, "force z": -0.3}),
        ((0.0, 0.0, 0.0), 1.25, "forces scaled", {"force scale": 0.8}),
    ],
)
def test_a_force_sensors_zero_or_gain_is_found_and_put_right(
    smooth: Any,
    make: Make,
    shift: tuple[float, ...],
    scale: float,
    form: str,
    parameters: dict[str, float],
) -> None:
    recording = make(9_000, seed=3)
    force = scale * recording.samples.force + np.array(shift)
    found = attributed(smooth, replace(recording, samples=replace(recording.samples, force=force)))
    frame = only(found)
    assert (frame.name, frame.candidate.form) == ("frame", form)
    told = {name: value for name, (value, _) in frame.candidate.form_parameters.items()}
    assert told == pytest.approx(parameters, abs=0.05)
    assert np.sqrt((found.residual**2).mean()) < 1.1 * 4.0


class Jumpy:
    """A model whose prediction jumps from row to row, as a forest's does where its inputs have noise."""

    def __init__(self, smooth: Any) -> None:
        self._smooth, self.manifest = smooth, smooth.manifest
        self._directions = np.random.default_rng(1).normal(size=(6, 21)) * 1e4

    def predict(self, windows: np.ndarray) -> np.ndarray:
        jumps = np.sin(windows[:, :6].astype(np.float64) @ self._directions)
        return np.asarray(self._smooth.predict(windows) + 20.0 * jumps, dtype=np.float32)

    def predict_base(self, windows: np.ndarray) -> np.ndarray:
        return self.predict(windows)


def test_a_turned_frame_is_found_though_predictions_jump(smooth: Any, make: Make) -> None:
    """With turned inputs, they jump otherwise."""
    recording = make(9_000, seed=3)
    force = Rotation.from_rotvec(np.radians(15.0) * np.array([0.6, 0.0, 0.8])).apply(
        recording.samples.force
    )
    turned = replace(recording, samples=replace(recording.samples, force=force))
    found = attributed(Jumpy(smooth), turned)
    first, *_ = found.named
    assert (first.name, first.candidate.form) == ("frame", "forces turned, seen in slow changes")


def test_a_frame_that_slips_in_the_course_of_a_recording_is_found(smooth: Any, make: Make) -> None:
    found = attributed(smooth, slipped(make(9_000, seed=3)))
    frame = only(found)
    assert frame.name == "frame"
    parameters = {name: value for name, (value, _) in frame.candidate.form_parameters.items()}
    # The recorded forces are turned back.
    assert parameters["angle"] == pytest.approx(25.0, abs=2.0)
    assert (parameters["x"], parameters["z"]) == (
        pytest.approx(-15.0, abs=2.0),
        pytest.approx(-20.0, abs=2.0),
    )
    assert parameters["begins"] == pytest.approx(36.0, abs=5.0)
    assert not frame.candidate.online(frame.weights).changes_something
    assert np.sqrt((found.residual**2).mean()) < 1.1 * 4.0


def test_a_slip_that_a_large_offset_hides_is_found_beside_it(smooth: Any, make: Make) -> None:
    recording = slipped(make(9_000, seed=3))
    offsets = np.random.default_rng(8).normal(0.0, 400.0, 21)
    found = attributed(smooth, replace(recording, channels=np.rint(recording.channels + offsets)))
    assert names(found) == ["offset", "frame"]


def test_a_turned_frame_is_no_offset_although_it_shifts_all_channels(smooth: Any, make: Make) -> None:
    recording = make(9_000, seed=3)
    turn = Rotation.from_rotvec(np.radians(30.0) * np.array([0.0, 0.6, 0.8]))
    samples = replace(recording.samples, force=turn.apply(recording.samples.force))
    offsets = np.random.default_rng(2).normal(0.0, 3.0, 21)
    found = attributed(smooth, replace(recording, samples=samples, channels=recording.channels + offsets))
    frame = found.named[0]
    assert frame.name == "frame"
    assert frame.candidate.form_parameters["angle"][0] == pytest.approx(30.0, abs=3.0)


def test_a_noisy_driver_is_served_with_the_part_that_single_rows_bear(smooth: Any, make: Make) -> None:
    recording, random = make(12_000, seed=3), np.random.default_rng(5)
    force = np.linalg.norm(recording.samples.force, axis=1)
    viscous = np.gradient(force, 0.01)[:, None] * np.linspace(4.0, 10.0, 21)
    noisy = recording.samples.force + random.normal(0.0, 0.1, (len(recording), 3))
    channels = np.clip(np.rint(recording.channels + viscous), 0, 4095)
    recorded = replace(recording, samples=replace(recording.samples, force=noisy), channels=channels)
    result = run_loop(smooth, [recorded], LoopSettings())
    (rate,) = result.attribution.named
    assert rate.name == "rate"
    assert rate.served_share.max() < 0.9
    np.testing.assert_allclose(rate.served_weights, rate.weights * rate.served_share[:, None])
    observations, blocks = result.observations, result.blocks

    def error(contribution: np.ndarray, rows: np.ndarray) -> np.ndarray:
        return np.asarray(((observations.residual - contribution)[rows] ** 2).mean(axis=0))

    whole = rate.contribution / rate.served_share
    assert (
        error(rate.contribution, blocks.fit) < (observations.residual[blocks.fit] ** 2).mean(axis=0)
    ).all()
    assert (error(rate.contribution, blocks.evaluation) < error(whole, blocks.evaluation)).all()


def test_a_share_of_a_contribution_is_taken_where_it_lowers_the_error(smooth: Any, make: Make) -> None:
    injection = into(make)
    offsets = np.linspace(-20.0, 25.0, 21)
    add(injection, offsets[None])
    found = only(attributed(smooth, injection.recording))
    np.testing.assert_allclose(found.served_share[np.abs(offsets) > 3.0], 1.0, atol=0.02)
    assert found.served_share.max() <= 1.0


def test_a_drift_is_named_before_offsets_of_contacts_that_contain_it(smooth: Any, make: Make) -> None:
    def in_contacts(seed: int) -> Recording:
        ticks = make(15_000, seed=seed, materials=False).ticks()
        return ticks.rows(np.arange(len(ticks)) % 600 >= 20)

    random = np.random.default_rng(4)
    recording = in_contacts(3)
    added = np.zeros_like(recording.channels)
    for number, part in enumerate(recording.segments):
        added[part] = random.normal(0.0, 25.0, 21)
        added[part] += np.linspace(-200.0, 200.0, 21) * (number / len(recording.segments) - 0.5)
    changed = replace(recording, channels=np.rint(recording.channels + added))
    observations = gather(smooth, [changed])
    found = JointSelection(
        observations,
        cut(observations, seed=0),
        candidates(observations),
        reference=held_out_residual(smooth, [in_contacts(4)]),
    ).run()
    assert names(found) == ["drift", "offset:contact"]


def test_a_fault_of_one_channel_comes_behind_what_explains_more(smooth: Any, make: Make) -> None:
    injection = into(make)
    add(injection, np.full((1, 21), 24.0))
    counts = injection.recording.channels.copy()
    counts[:, 7] = 2000.0
    found = attributed(smooth, replace(injection.recording, channels=counts))
    assert names(found) == ["offset", "fault"]
    _, fault = found.named
    assert fault.channels == (CHANNELS[7],)
    assert fault.confounded_with == ()


def test_a_form_whose_weights_contradict_its_cause_is_not_named(smooth: Any, make: Make) -> None:
    injection = into(make, 12_000)
    clock = injection.time_s - injection.time_s.mean()
    slopes = 24.0 * np.linspace(-1.0, 3.0, 21) / np.sqrt((clock**2).mean())
    add(injection, clock[:, None] * slopes)
    # The twin's tdc rises with the clock, so that a temperature would explain it as well.
    found = attributed(smooth, injection.recording, exclude=("drift", "gain", "frame"))
    assert "temperature" not in names(found)
    (temperature,) = [one for one in found.rejected if one.name == "temperature"]
    assert temperature.reason == "its weights differ more than its cause allows"


@pytest.mark.parametrize(
    ("least_share", "kept"),
    [
        (0.003, True),
        pytest.param(
            0.02,
            False,
            marks=pytest.mark.xfail(
                strict=True,
                reason="0.8 % of the error is 2.3 % of the whitened error, where an offset counts less",
            ),
        ),
    ],
)
def test_a_small_effect_stays_where_it_is_asked_for(
    smooth: Any, make: Make, least_share: float, kept: bool
) -> None:
    injection = into(make, 20_000)
    inject(injection, "offset", 1.0)
    inject(injection, "hysteresis", 0.06)
    some = replace(DECLARED, least_share=least_share)
    found = attributed(smooth, injection.recording, some, exclude=("lag", "frame", "location"))
    assert names(found)[0] == "offset"
    assert ("hysteresis" in names(found)) == kept


def test_every_effect_that_has_a_form_is_named_or_rejected(smooth: Any, make: Make) -> None:
    injection = into(make, 9_000)
    inject(injection, "offset", 1.0)
    found = attributed(smooth, injection.recording)
    every = [*names(found), *(one.name for one in found.rejected)]
    # No channel is stuck, and there is no wave: neither has a form.
    expected = {effect.label for effect in candidates(found.observations)} - {"fault", "interference"}
    # Without a reference, offsets of contacts are out of scope, which is told.
    assert sorted(every) == sorted({*expected, "offset:contact"})


def test_the_evaluation_part_is_not_used(smooth: Any, make: Make) -> None:
    injection = into(make)
    inject(injection, "gain", 1.0)
    observations = gather(smooth, [injection.recording])
    blocks = cut(observations, seed=0)
    effects = [effect for effect in candidates(observations) if effect.label in ("offset", "gain", "creep")]
    measured = observations.measured.copy()
    measured[blocks.evaluation] += 500.0
    other = replace(observations, measured=measured)
    first, second = (JointSelection(one, blocks, effects).run() for one in (observations, other))
    assert names(first) == names(second)
    for one, again in zip(first.named, second.named, strict=True):
        np.testing.assert_array_equal(one.weights, again.weights)


def test_creep_is_not_refined_beyond_what_the_contacts_show(observations: Observations) -> None:
    (effect,) = [one for one in candidates(observations) if one.label == "creep"]
    blocks = cut(observations, seed=0)
    bins = Bins.of(blocks, DECLARED.bin_s)
    whitening = Whitening(bins, NoiseShape.usual(), observations.residual, DECLARED)
    remaining: Any = None
    forms = list(effect.forms(observations, remaining))
    longest = max(one.form_parameters["time_constant"][0] for one in forms)
    for form in prepared(forms[-1], whitening):
        finer = list(effect.finer(observations, form.candidate, blocks.fit))
        assert max(one.form_parameters["time_constant"][0] for one in finer) <= longest


def test_places_are_those_of_the_window_that_a_lag_chose(observations: Observations) -> None:
    (location,) = [one for one in candidates(observations) if one.label == "location"]
    remaining: Any = type("Remaining", (), {"fit": cut(observations, seed=0).fit})
    late = observations.with_windows(observations.windows[observations.rows_before(8)], shift_ticks=8)
    (form,) = location.forms(observations, remaining)
    assert form.again is not None
    weights = np.ones((len(CHANNELS), form.basis.size))
    before, after = form.basis.times(weights), form.again(late).basis.times(weights)
    np.testing.assert_allclose(after, before[observations.rows_before(8)], rtol=1e-12)


def test_the_pipeline_passes_its_settings_on(smooth: Any, make: Make) -> None:
    injection = into(make)
    inject(injection, "offset", 1.0)
    told: list[str] = []
    findings = run_loop(smooth, [injection.recording], LoopSettings(least_share=1.0), told.append).findings
    assert findings.effects == ()
    assert "creep" in told
