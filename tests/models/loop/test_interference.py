"""Interference is named with its frequency and channels, and nothing else is taken for it."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import pytest

from taxel.channels import CHANNELS
from taxel_models.ground.real import SLIDE, RealGround
from taxel_models.loop.blocks import cut
from taxel_models.loop.effects.effect import Candidate, Remaining
from taxel_models.loop.effects.interference import Interference, fitted_wave
from taxel_models.loop.observations import Observations, gather
from taxel_models.loop.pipeline import LoopSettings, run_loop
from taxel_models.recordings import Recording
from taxel_models.recovery.injected import inject_truth
from taxel_models.recovery.injection import Injection
from taxel_models.recovery.injectors import inject

Make = Callable[..., Recording]

TICK: Final = 0.01
NOISE: Final = np.full(len(CHANNELS), 4.0)


def forms(model: Any, recording: Recording) -> list[Candidate]:
    observations = gather(model, [recording])
    return list(Interference().forms(observations, remaining(observations)))


def remaining(observations: Observations) -> Remaining:
    fit = cut(observations, seed=0).fit
    return Remaining(observations.residual, fit, np.ones(len(observations)))


def with_wave(recording: Recording, frequency: float, channels: list[int], size: float = 4.0) -> Recording:
    counts = recording.channels.copy()
    time = recording.samples.time_ns / 1e9
    counts[:, channels] = np.rint(
        counts[:, channels] + size * np.sin(2 * np.pi * frequency * time + 0.4)[:, None]
    )
    return replace(recording, channels=counts)


@pytest.mark.parametrize("strength", [0.7, 2.0])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_it_is_found_with_its_frequency_and_channels(
    smooth: Any, make: Make, strength: float, seed: int
) -> None:
    injection = Injection.into(make(seed=seed), seed, NOISE)
    inject(injection, "interference", strength)
    truth = injection.truth[0]["parameters"]
    (found,) = forms(smooth, injection.recording)
    assert found.form_parameters["frequency"][0] == pytest.approx(truth["frequency"], abs=0.1)
    assert found.form == f"{found.form_parameters['frequency'][0]:.1f} Hz in {truth['channels']}"


@pytest.mark.parametrize("seed", [3, 4, 5, 6, 7])
def test_nothing_is_found_in_a_clean_recording(smooth: Any, make: Make, seed: int) -> None:
    assert forms(smooth, make(seed=seed)) == []


@pytest.mark.parametrize("cause", ["creep", "rate", "lag", "fault", "unknown:telegraph", "unknown:bursts"])
def test_other_causes_are_not_taken_for_it(smooth: Any, make: Make, cause: str) -> None:
    injection = Injection.into(make(), 2, NOISE)
    inject_truth(injection, cause, 3.0)
    assert forms(smooth, injection.recording) == []


def pressing(smooth: Any, recording: Recording, hz: float, wrong: float) -> Recording:
    """A press that repeats, and an error that grows with the square of the force, less when it falls."""
    samples = recording.samples
    time = (samples.time_ns - samples.time_ns[0]) / 1e9
    load = np.maximum(np.sin(2 * np.pi * hz * time), 0.0)
    force = np.outer(2.0 * load, [0.0, 0.2, 1.0])
    position = np.broadcast_to(samples.position.mean(axis=0), samples.position.shape)
    error = wrong * load**2 * np.sign(np.cos(2 * np.pi * hz * time))
    noise = 4.0 * np.random.default_rng(0).normal(size=recording.channels.shape)
    counts = smooth.counts(position, force) + error[:, None] + noise
    return replace(
        recording,
        samples=replace(samples, position=position.copy(), force=force),
        channels=np.clip(np.rint(counts), 0, 4095),
    )


@pytest.mark.parametrize("hz", [0.7, 1.3, 2.6])
@pytest.mark.parametrize("wrong", [10.0, 60.0])
def test_the_harmonics_of_a_press_that_repeats_are_not_it(
    smooth: Any, recording: Recording, hz: float, wrong: float
) -> None:
    assert forms(smooth, pressing(smooth, recording, hz, wrong)) == []


def test_it_is_found_beside_a_press_that_repeats(smooth: Any, recording: Recording) -> None:
    pressed = with_wave(pressing(smooth, recording, 0.7, 10.0), 17.3, [4, 9], 8.0)
    assert [found.form for found in forms(smooth, pressed)] == ["17.3 Hz in e3, e8"]


@pytest.mark.parametrize("hz", [0.4, 1.2])
def test_slow_waves_are_not_it(smooth: Any, recording: Recording, hz: float) -> None:
    assert forms(smooth, with_wave(recording, hz, [3, 4, 5], 20.0)) == []


def shaken(smooth: Any, recording: Recording, frequency: float) -> Recording:
    """A recording of many contacts; in each, the force shakes at a frequency, with a phase of its own."""
    ticks = recording.ticks()
    parts = ticks.rows(np.arange(len(ticks)) % 700 >= 20)
    random = np.random.default_rng(1)
    force, counts = parts.samples.force.copy(), parts.channels.copy()
    residual = counts - smooth.counts(parts.samples.position, force)
    for part in parts.segments:
        time = TICK * np.arange(part.stop - part.start)
        force[part, 2] += 0.2 * np.sin(2 * np.pi * (frequency * time + random.random()))
    counts = smooth.counts(parts.samples.position, force) + residual
    samples = replace(parts.samples, force=force)
    return replace(parts, samples=samples, channels=np.clip(np.rint(counts), 0, 4095))


def test_it_is_found_where_the_force_shakes_at_its_frequency(smooth: Any, make: Make) -> None:
    """The force's wave starts anew in each contact; the interference goes on."""
    moving = shaken(smooth, make(20_000), 17.3)
    assert forms(smooth, moving) == []
    assert [one.form for one in forms(smooth, with_wave(moving, 17.3, [4, 9], 8.0))] == [
        "17.3 Hz in e3, e8"
    ]


def test_what_the_model_lacks_of_a_shaking_force_is_not_it(smooth: Any, make: Make) -> None:
    moving = shaken(smooth, make(20_000), 17.3)
    pressed = moving.samples.force[:, 2]
    wrong = moving.channels.copy()
    wrong[:, [4, 9]] = np.rint(wrong[:, [4, 9]] + 60.0 * (pressed - pressed.mean())[:, None])
    assert forms(smooth, replace(moving, channels=wrong)) == []


def test_a_weaker_line_is_found_beside_one_of_the_movement(smooth: Any, make: Make) -> None:
    moving = shaken(smooth, make(20_000), 17.3)
    wrong = moving.channels.copy()
    wrong[:, 4:12] = np.rint(wrong[:, 4:12] + 200.0 * (moving.samples.force[:, 2:] - 1.0))
    wave = with_wave(replace(moving, channels=np.clip(wrong, 0, 4095)), 29.1, [15, 16], 8.0)
    assert [one.form for one in forms(smooth, wave)] == ["29.1 Hz in e14, e15"]


def test_each_segment_has_its_own_phase(smooth: Any, recording: Recording) -> None:
    ticks = recording.ticks()
    parts = ticks.rows(np.arange(len(ticks)) % 700 >= 100)
    turned = parts.channels.copy()
    random = np.random.default_rng(0)
    for part in parts.segments:
        time = TICK * np.arange(part.stop - part.start)
        turned[part, 7] += np.rint(8.0 * np.sin(2 * np.pi * (6.3 * time + random.random())))
    (found,) = forms(smooth, replace(parts, channels=turned))
    assert found.form == "6.3 Hz in e6"


def test_it_is_found_in_segments_that_are_cut_into_short_blocks(smooth: Any, recording: Recording) -> None:
    ticks = recording.ticks()
    parts = ticks.rows(np.arange(len(ticks)) % 500 >= 20)
    observations = gather(smooth, [parts])
    assert np.diff(np.flatnonzero(np.diff(cut(observations, seed=0).of_row))).max() < 256
    (found,) = forms(smooth, with_wave(parts, 6.3, [7], 8.0))
    assert found.form == "6.3 Hz in e6"


def test_a_wave_is_fitted_by_the_rows_that_are_given(observations: Observations) -> None:
    wave = np.cos(2 * np.pi * 5.0 * observations.time_s + 1.0)[:, None] * np.arange(21.0)
    rows = np.arange(len(observations)) % 1000 < 400
    slope = observations.time_s[:, None] * 3.0 + 100.0
    fitted = fitted_wave(observations, np.where(rows[:, None], wave + slope, 1e6), rows, 5.0, [1])
    np.testing.assert_allclose(fitted, wave, atol=1e-6)
    none = np.zeros(len(observations), bool)
    assert not fitted_wave(observations, wave, none, 5.0, [1]).any()


def test_it_is_named_but_not_served(smooth: Any, make: Make) -> None:
    result = run_loop(smooth, [with_wave(make(), 7.3, [4, 6, 11], 8.0)], LoopSettings())
    (effect,) = result.findings.effects
    assert (effect.name, effect.form, effect.served) == ("interference", "7.3 Hz in e3, e5, e10", False)
    assert effect.explained > 0.08
    assert effect.channels == ("e3", "e5", "e10")
    assert [(one.name, one.unit) for one in effect.parameters] == [("frequency", "Hz")]
    assert effect.parameters[0].value == pytest.approx(7.3, abs=0.01)
    np.testing.assert_array_equal(result.after, result.observations.predicted)
    assert not result.findings.unexplained.structured
    (named,) = result.attribution.named
    left = result.attribution.residual[result.blocks.evaluation][:, [4, 6, 11]]
    assert left.std() == pytest.approx(4.0, rel=0.1)
    assert named.contribution[:, [4, 6, 11]].std() == pytest.approx(8.0 / np.sqrt(2), rel=0.05)


def test_it_is_named_beside_another_effect(smooth: Any, make: Make) -> None:
    injection = Injection.into(make(12_000), 2, np.full(21, 12.0))
    inject(injection, "offset", 1.0)
    recording = with_wave(injection.recording, 9.1, [3, 8], 12.0)
    findings = run_loop(smooth, [recording], LoopSettings()).findings
    assert {effect.name for effect in findings.effects} == {"offset", "interference"}


@pytest.mark.measured
def test_lasa_recordings_have_none(data_folder: Path) -> None:
    ground = RealGround.lasa(data_folder, seed=1, jobs=2)
    for number in range(3):
        clean = ground.clean(number)
        assert forms(clean.model, clean.recording) == []


@pytest.mark.measured
def test_slide_recordings_have_none(data_folder: Path, tmp_path: Path) -> None:
    (tmp_path / SLIDE).mkdir()
    for material in ("mat5", "mat6", "mat7"):
        (tmp_path / SLIDE / material).symlink_to(data_folder / SLIDE / material)
    ground = RealGround.slide(tmp_path, seed=1, jobs=2)
    for number in range(3):
        clean = ground.clean(number)
        assert forms(clean.model, clean.recording) == []
        wave = with_wave(clean.recording, 11.7, [5, 12], 2.0 * clean.recording.channels[:, 5].std())
        assert [found.form for found in forms(clean.model, wave)] == ["11.7 Hz in e4, e11"]
