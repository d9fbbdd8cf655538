"""Effects are put into a recording at the strength that was asked for, and nowhere else."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from taxel.errors import SettingsError
from taxel_models.loop.effects.registry import NAMES, effect_named
from taxel_models.recordings import Recording
from taxel_models.recovery.injected import inject_truth
from taxel_models.recovery.injection import USUAL_RESIDUAL, Injection
from taxel_models.recovery.injectors import INJECTORS, inject
from taxel_models.recovery.unknown import UNKNOWN

RESIDUAL = np.linspace(10.0, 30.0, 21)
SCALED = [name for name in NAMES if name not in ("frame", "fault", "lag")]


def injected(recording: Recording, name: str, strength: float, seed: int = 3) -> Injection:
    injection = Injection.into(recording, seed, RESIDUAL)
    inject_truth(injection, name, strength)
    return injection


@pytest.mark.parametrize("name", [*SCALED, "covariate:material", "unknown:telegraph", "unknown:bursts"])
@pytest.mark.parametrize("strength", [0.5, 2.0])
def test_strength_is_the_change_over_the_residual(recording: Recording, name: str, strength: float) -> None:
    injection = injected(recording, name, strength)
    change = injection.recording.channels - recording.channels
    touched = np.abs(change).max(axis=0) > 0
    relative = (change / RESIDUAL)[:, touched]
    # Counts are whole and end at 0 and 4095.
    assert np.sqrt((relative**2).mean()) == pytest.approx(strength, rel=0.1)


@pytest.mark.parametrize("name", [*NAMES, "covariate:material", *(f"unknown:{one}" for one in UNKNOWN)])
def test_a_seed_says_everything(recording: Recording, name: str) -> None:
    first, again, other = (injected(recording, name, 1.0, seed) for seed in (3, 3, 4))
    np.testing.assert_array_equal(first.recording.channels, again.recording.channels)
    np.testing.assert_array_equal(first.recording.samples.force, again.recording.samples.force)
    assert first.truth == again.truth
    assert first.truth[0]["name"] == name
    if name != "lag":
        same = (first.recording.channels == other.recording.channels).all()
        assert not same or (first.recording.samples.force != other.recording.samples.force).any()


@pytest.mark.parametrize("name", NAMES)
def test_counts_stay_whole_and_in_range(recording: Recording, name: str) -> None:
    counts = injected(recording, name, 2.0).recording.channels
    np.testing.assert_array_equal(counts, np.rint(counts))
    assert counts.min() >= 0
    assert counts.max() <= 4095


def test_other_columns_are_left_alone(recording: Recording) -> None:
    for name in NAMES:
        injection = injected(recording, name, 1.0)
        found = injection.recording
        for column in ("tdc", "tac", "pac1"):
            np.testing.assert_array_equal(found.auxiliary[column], recording.auxiliary[column])
        np.testing.assert_array_equal(found.covariates["material"], recording.covariates["material"])
        np.testing.assert_array_equal(found.samples.time_ns, recording.samples.time_ns)
        if name == "frame":
            np.testing.assert_array_equal(found.channels, recording.channels)
            sizes = (np.linalg.norm(one.samples.force, axis=1) for one in (found, recording))
            np.testing.assert_allclose(*sizes, atol=1e-9)
        else:
            np.testing.assert_array_equal(found.samples.force, recording.samples.force)


def test_several_effects_add_up(recording: Recording) -> None:
    injection = Injection.into(recording, 3, RESIDUAL)
    inject(injection, "offset", 1.0)
    once = injection.recording.channels
    inject(injection, "rate", 0.5)
    assert [one["name"] for one in injection.truth] == ["offset", "rate"]
    assert [one["strength"] for one in injection.truth] == [1.0, 0.5]
    change = (injection.recording.channels - once) / RESIDUAL
    assert np.sqrt((change**2).mean()) == pytest.approx(0.5, rel=0.1)


def test_a_lag_stays_inside_segments(make: Callable[..., Recording]) -> None:
    made = make(3000)
    channels = made.channels + 200.0 * (np.arange(3000) >= 1500)[:, None]
    parts = replace(made, channels=channels).rows(np.abs(np.arange(3000) - 1500) > 20)
    second = parts.segments[1]
    injection = injected(parts, "lag", 1.0)
    found = injection.recording.channels
    ticks = round(injection.truth[0]["parameters"]["lag"] * 100)
    np.testing.assert_array_equal(
        found[second][:ticks], np.repeat(parts.channels[second][:1], ticks, axis=0)
    )
    np.testing.assert_array_equal(found[second][ticks:], parts.channels[second][:-ticks])


def test_a_tenth_of_the_spread_is_the_usual_residual(recording: Recording) -> None:
    injection = Injection.into(recording, 0)
    np.testing.assert_allclose(injection.residual, USUAL_RESIDUAL * recording.channels.std(axis=0))


@pytest.mark.parametrize("name", ["rate", "creep", "hysteresis"])
def test_what_changes_nothing_is_refused(recording: Recording, name: str) -> None:
    still = replace(recording.samples, force=np.zeros_like(recording.samples.force))
    with pytest.raises(SettingsError, match="what it depends on is constant"):
        injected(replace(recording, samples=still), name, 1.0)


def test_every_effect_has_an_injector() -> None:
    assert set(INJECTORS) == set(NAMES)


@pytest.mark.parametrize(("values", "kinds"), [((1.0, 2.0, 4.0), True), ((1.0, 2.0, 4.5), False)])
def test_a_column_of_whole_numbers_names_kinds(
    recording: Recording, values: tuple[float, ...], kinds: bool
) -> None:
    column = np.resize(values, len(recording))
    found = injected(replace(recording, covariates={"x": column}), "covariate:x", 1.0)
    assert np.shape(found.truth[0]["parameters"]["weight"]) == ((3, 21) if kinds else (21,))


def test_unknown_names_are_refused(recording: Recording) -> None:
    with pytest.raises(SettingsError, match="no effect 'wear': expected one of offset, gain"):
        effect_named("wear")
    with pytest.raises(SettingsError, match="no column 'mood' to inject by; the recording has: material"):
        injected(recording, "covariate:mood", 1.0)
