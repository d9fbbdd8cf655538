"""Foreign causes reach the strength that was asked for, have their forms, and change nothing else."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from taxel.channels import CHANNELS
from taxel.errors import SettingsError
from taxel_models.foreign.injection import ForeignInjection
from taxel_models.foreign.memory import _bouc_wen
from taxel_models.foreign.registry import INJECTORS, UNKNOWN, injector_named
from taxel_models.ground.twins import contacts_of
from taxel_models.loop.effects.registry import NAMES
from taxel_models.loop.inference.contact_offset import ContactOffset
from taxel_models.recordings import Recording

DEVIATION = np.linspace(10.0, 30.0, 21)
ALL = [injector.name for injector in (*INJECTORS, *UNKNOWN)]

REPLACING = {
    "fault: intermittent",
    "fault: stuck",
    "saturation: soft",
    "fault: crossed wires",
    *(name for name in ALL if name.startswith("frame")),
    "dying electrode: linear",
    "dying electrode: exponential",
    "dying electrode: stepwise",
    *(name for name in ALL if name.startswith("lag")),
}
"""What these change has a size of its own; the others are scaled."""

Inject = Callable[..., ForeignInjection]


@pytest.fixture
def inject(recording: Recording, smooth: Any) -> Inject:
    def injected(
        name: str, strength: float = 1.0, seed: int = 3, of: Recording = recording, **others: Any
    ) -> ForeignInjection:
        fields: dict[str, Any] = {"live": np.ones(21, bool), "on_skin": True, **others}
        injection = ForeignInjection(
            of,
            np.random.default_rng(seed),
            DEVIATION.copy(),
            contacts_of(of),
            respond=smooth.counts,
            strength=strength,
            **fields,
        )
        injector_named(name).inject(injection)
        return injection

    return injected


def test_right_names_are_those_of_the_loop() -> None:
    names = {*NAMES, ContactOffset.name, "covariate:material"}
    assert {name for injector in INJECTORS for name in injector.right} <= names
    assert all(injector.right for injector in INJECTORS)
    assert not any(injector.right for injector in UNKNOWN)
    assert len(set(ALL)) == len(ALL)


@pytest.mark.parametrize("name", sorted(set(ALL) - REPLACING))
def test_the_strength_is_that_of_the_change(inject: Inject, recording: Recording, name: str) -> None:
    for strength in (0.5, 2.0):
        change = inject(name, strength).recording.channels - recording.channels
        touched = np.abs(change).max(axis=0) > 0
        reached = np.sqrt(((change / DEVIATION)[:, touched] ** 2).mean())
        assert reached == pytest.approx(strength, rel=0.1)


@pytest.mark.parametrize(
    "name",
    [name for name in ALL if name != "offset" and not name.startswith(("fault", "frame"))],
)
def test_a_trained_model_has_absorbed_the_mean(inject: Inject, recording: Recording, name: str) -> None:
    change = inject(name).recording.channels - recording.channels
    # Counts are whole and end at 0 and 4095.
    assert (np.abs(change.mean(axis=0)) < 0.1 * DEVIATION).all()


@pytest.mark.parametrize("name", ALL)
def test_a_seed_says_everything(inject: Inject, name: str) -> None:
    first, again, other = inject(name), inject(name), inject(name, seed=5)
    np.testing.assert_array_equal(first.recording.channels, again.recording.channels)
    np.testing.assert_array_equal(first.recording.samples.force, again.recording.samples.force)
    assert first.parameters == again.parameters
    if name not in ("lag: delay", "lag: first order", "frame: force sensor's gain"):
        apart = (first.recording.channels != other.recording.channels).any()
        assert apart or (first.recording.samples.force != other.recording.samples.force).any()


@pytest.mark.parametrize("name", ALL)
def test_nothing_else_changes(inject: Inject, recording: Recording, name: str) -> None:
    live = np.arange(21) >= 2
    found = inject(name, 2.0, live=live).recording
    np.testing.assert_array_equal(found.channels, np.rint(found.channels))
    assert found.channels.min() >= 0
    assert found.channels.max() <= 4095
    np.testing.assert_array_equal(found.channels[:, ~live], recording.channels[:, ~live])
    np.testing.assert_array_equal(found.samples.time_ns, recording.samples.time_ns)
    np.testing.assert_array_equal(found.covariates["material"], recording.covariates["material"])
    if name != "temperature: by contact":
        np.testing.assert_array_equal(found.auxiliary["tdc"], recording.auxiliary["tdc"])
    if name.startswith("frame"):
        np.testing.assert_array_equal(found.channels, recording.channels)
        moved = found.samples.force != recording.samples.force
        assert moved[-1].any()
        assert moved[0].any() == (name != "frame: slipped")
        if name in ("frame: slipped", "frame: turned"):
            sizes = (np.linalg.norm(one.samples.force, axis=1) for one in (found, recording))
            np.testing.assert_allclose(*sizes, atol=1e-9)
        else:
            np.testing.assert_array_equal(found.samples.position, recording.samples.position)
    else:
        np.testing.assert_array_equal(found.samples.force, recording.samples.force)


def course(injection: ForeignInjection, before: Recording) -> NDArray[np.float64]:
    """(n,) what an injection adds to the channel that it changes most, about its first value."""
    change = injection.recording.channels - before.channels
    column = change[:, np.argmax(change.std(axis=0))]
    return np.asarray((column - column[0]) / np.abs(column - column[0]).max())


def stepped(recording: Recording, load: NDArray[np.float64]) -> Recording:
    """The recording with this load (n,) along z, and channels that have room."""
    force = np.column_stack([np.zeros((len(load), 2)), -load])
    samples = replace(recording.samples, force=force)
    return replace(recording, samples=samples, channels=np.full((len(load), 21), 2000.0))


def test_power_law_creep_grows_with_a_power_of_the_time_since_a_step(
    inject: Inject, recording: Recording
) -> None:
    load = np.where(np.arange(len(recording)) < 1000, 1.0, 3.0)
    before = stepped(recording, load)
    injection = inject("creep: power law", 5.0, of=before)
    strain = np.abs(course(injection, before))
    assert (strain[:1001] == 0).all()
    exponent = injection.parameters["exponent"]
    assert strain[1400] / strain[5000] == pytest.approx((400 / 4000) ** exponent, rel=0.03)


def test_bouc_wen_depends_on_the_way_and_not_on_the_speed() -> None:
    way = np.concatenate([np.linspace(0, 3, 100), np.linspace(3, 1, 80), np.linspace(1, 4, 120)])
    slow = np.interp(np.arange(0, 299.01, 0.25), np.arange(300), way)
    fast, unhurried = _bouc_wen(way, 1.5, 0.0), _bouc_wen(slow, 1.5, 0.0)
    np.testing.assert_allclose(unhurried[::4], fast, atol=0.03)
    assert np.abs(fast).max() < 1.02
    up, down = np.argmin(np.abs(way[:100] - 2.0)), 100 + np.argmin(np.abs(way[100:180] - 2.0))
    assert fast[up] - fast[down] > 0.5
    faded = _bouc_wen(np.concatenate([way, np.full(2000, 4.0)]), 1.0, 0.01)
    assert abs(faded[-1]) < 1e-6


def test_a_delay_reads_what_was_there_before(inject: Inject, make: Callable[..., Recording]) -> None:
    parts = make(3000).rows(np.abs(np.arange(3000) - 1500) > 20)
    injection = inject("lag: delay", of=parts)
    late = injection.parameters["lag"]
    assert 0.005 <= late <= 0.1
    second = parts.segments[1]
    time = np.arange(second.stop - second.start) * 0.01
    for column in (5, 12):
        was = np.interp(time - late, time, parts.channels[second, column])
        change = injection.recording.channels[second, column] - was
        # Only a constant and the rounding are between them.
        assert np.ptp(change) <= 1.0 + 1e-9


def test_dropped_frames_repeat_all_channels(inject: Inject, recording: Recording) -> None:
    found = inject("lag: dropped frames").recording.channels
    held = (np.diff(found[:, 2:], axis=0) == 0).all(axis=1)
    assert not (np.diff(recording.channels[:, 2:], axis=0) == 0).all(axis=1).any()
    assert held.mean() > 0.03


def test_electrodes_fail_as_they_should(inject: Inject, recording: Recording) -> None:
    stuck = inject("fault: stuck")
    changed = np.flatnonzero((stuck.recording.channels != recording.channels).any(axis=0))
    assert len(changed) == 1
    since = stuck.parameters["since"]
    assert np.ptp(stuck.recording.channels[stuck.time_s >= since, changed[0]]) == 0
    dying = inject("dying electrode: linear", 0.5)
    (column,) = np.flatnonzero((dying.recording.channels != recording.channels).any(axis=0))
    late = dying.time_s > 0.9 * dying.time_s[-1]
    spreads = [one.channels[late, column].std() for one in (dying.recording, recording)]
    left = dying.parameters["sensitivity_left"]
    assert 0 <= left < 1
    assert spreads[0] / spreads[1] == pytest.approx(left + 0.05 * (1 - left), abs=0.1)


def test_interference_has_its_frequency_in_some_channels(inject: Inject, recording: Recording) -> None:
    injection = inject("interference", 2.0)
    change = injection.recording.channels - recording.channels
    touched = np.flatnonzero(np.abs(change).max(axis=0))
    assert 4 <= len(touched) <= 12
    spectrum = np.abs(np.fft.rfft(change[:, touched[0]] - change[:, touched[0]].mean()))
    peak = np.fft.rfftfreq(len(change), 0.01)[np.argmax(spectrum)]
    assert peak == pytest.approx(injection.parameters["frequency"], abs=0.02)


def test_a_contact_keeps_its_offset(inject: Inject, recording: Recording) -> None:
    injection = inject("contact offset")
    change = injection.recording.channels - recording.channels
    contacts = contacts_of(recording)
    within = [np.ptp(change[contacts == number, 7]) for number in np.unique(contacts)]
    means = [change[contacts == number, 7].mean() for number in np.unique(contacts)]
    assert np.median(within) <= 1.0
    assert np.std(means) > 0.5 * DEVIATION[7]


@pytest.mark.parametrize("name", ["creep: two constants", "creep: relaxing"])
def test_a_creep_begins_from_rest_or_settled(inject: Inject, recording: Recording, name: str) -> None:
    """Under a constant load, one that has settled changes nothing."""
    still, begun = stepped(recording, np.ones(len(recording))), set()
    for seed in range(8):
        try:
            injection = inject(name, of=still, seed=seed)
        except SettingsError:
            begun.add("settled")
            continue
        assert np.ptp(injection.recording.channels - still.channels, axis=0).max() > 2.0
        begun.add("from rest")
    assert begun == {"settled", "from rest"}


def test_a_cause_by_kind_needs_several_kinds(inject: Inject, recording: Recording) -> None:
    column = recording.covariates["material"]
    for kinds, fit in ((column, True), (np.full_like(column, 3.0), False)):
        of = replace(recording, covariates={"material": kinds})
        injection = inject("offset", of=of)
        assert injector_named("covariate: constant").fits(injection) is fit
        assert injector_named("covariate: gain").fits(injection) is fit
        assert injector_named("offset").fits(injection)


def test_what_changes_nothing_or_is_not_known_is_refused(inject: Inject, recording: Recording) -> None:
    still = stepped(recording, np.ones(len(recording)))
    with pytest.raises(SettingsError, match="what it depends on is constant"):
        inject("creep: power law", of=still)
    with pytest.raises(SettingsError, match="no injector 'wear': expected one of offset, contact offset"):
        injector_named("wear")


@pytest.mark.parametrize(
    "name", ["frame: turned", "frame: force sensor's zero", "frame: force sensor's gain"]
)
def test_a_motion_is_as_strong_as_the_model_answers_to_it(
    inject: Inject, recording: Recording, smooth: Any, name: str
) -> None:
    found = inject(name, 0.7)
    before, after = (
        smooth.counts(one.samples.position, one.samples.force) for one in (recording, found.recording)
    )
    relative = np.sqrt(((after - before) ** 2).mean(axis=0)) / DEVIATION
    assert np.sqrt((relative**2).mean()) == pytest.approx(0.7, rel=0.15)
    assert found.parameters["reached"] == pytest.approx(0.7, rel=0.15)


def test_crossed_wires_exchange_two_electrodes(inject: Inject, recording: Recording) -> None:
    found = inject("fault: crossed wires")
    one, other = map(CHANNELS.index, found.parameters["channels"])
    expected = recording.channels.copy()
    expected[:, [one, other]] = expected[:, [other, one]]
    np.testing.assert_array_equal(found.recording.channels, np.rint(expected))
