"""What a whole recording of the twin is like."""

import json
from pathlib import Path

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from taxel.channels import COUNTS_MAX, ELECTRODE_COLUMNS
from taxel.errors import SettingsError
from taxel.skin import height_above_skin
from taxel_models.commands.twin import twin
from taxel_models.recordings import Recording, read_ruppel
from taxel_models.twin import simulate
from taxel_models.twin.simulation import POSITION_EVERY
from taxel_models.twin.summary import summarise
from taxel_models.twin.temperature import celsius, core_celsius, tdc_counts

ROWS = 30_000


@pytest.fixture(scope="module")
def recording() -> Recording:
    return simulate(ROWS, 7)


@pytest.fixture(scope="module")
def force(recording: Recording) -> np.ndarray:
    return np.linalg.norm(recording.samples.force, axis=1)


def test_a_seed_says_everything() -> None:
    first, again, other = simulate(3000, 1), simulate(3000, 1), simulate(3000, 2)
    np.testing.assert_array_equal(first.channels, again.channels)
    np.testing.assert_array_equal(first.samples.position, again.samples.position)
    np.testing.assert_array_equal(first.samples.force, again.samples.force)
    assert (first.channels != other.channels).mean() > 0.5
    assert (first.samples.force != other.samples.force).all()


@pytest.mark.parametrize(("rows", "seed"), [(0, 1), (-5, 1), (10, -1)])
def test_bad_arguments_are_refused(rows: int, seed: int) -> None:
    with pytest.raises(SettingsError, match="expected at least 1 row"):
        simulate(rows, seed)


def test_the_shortest_recording_has_one_row() -> None:
    assert len(simulate(1, 0)) == 1


def test_time_is_100_hz_without_a_gap(recording: Recording) -> None:
    assert (np.diff(recording.samples.time_ns) == 10_000_000).all()
    assert recording.segments == (slice(0, ROWS),)


def test_every_count_is_a_whole_12_bit_number(recording: Recording) -> None:
    for counts in (recording.channels, *recording.auxiliary.values()):
        assert (counts == np.rint(counts)).all()
        assert counts.min() >= 0
        assert counts.max() <= COUNTS_MAX


def test_positions_change_at_10_hz_only(recording: Recording) -> None:
    changed = np.flatnonzero((np.diff(recording.samples.position, axis=0) != 0).any(axis=1)) + 1
    assert (changed % POSITION_EVERY == 0).all()
    assert len(changed) == ROWS // POSITION_EVERY - 1


def test_strong_contacts_lie_on_the_skin_and_free_air_off_it(
    recording: Recording, force: np.ndarray
) -> None:
    height = height_above_skin(recording.samples.position * 1000, 7.0)
    assert np.abs(height[force > 2.0]).max() < 3.5
    assert -1.2 < np.median(height[force > 2.0]) < 0.0
    assert height.max() > 15.0


def test_contacts_cover_the_skin(recording: Recording, force: np.ndarray) -> None:
    x, y, _ = recording.samples.position[force > 0.3].T * 1000
    assert x.min() < -12.0
    assert x.max() > 5.0
    assert y.min() < -5.0
    assert y.max() > 5.0


def test_forces_press_inwards_mostly_below_5_newtons(recording: Recording, force: np.ndarray) -> None:
    assert (force > 5.0).mean() < 0.1
    assert 4.0 < force.max() < 13.0
    strong = (force > 2.0) & (recording.samples.position[:, 0] < 0)
    outward = recording.samples.position[strong] * [0, 1, 1]
    assert np.median(np.einsum("ij,ij->i", outward, recording.samples.force[strong])) < 0


def test_pressed_electrodes_fall_and_others_rise(recording: Recording, force: np.ndarray) -> None:
    electrodes = recording.channels[:, ELECTRODE_COLUMNS]
    change = electrodes - np.median(electrodes[force < 0.05], axis=0)
    strong = force > 3.0
    assert np.median(change[strong].min(axis=1)) < -250
    assert 100 < np.median(change[strong].max(axis=1)) < 300


def test_pressure_follows_force(recording: Recording, force: np.ndarray) -> None:
    pdc = recording.channels[:, 1]
    levels = [np.median(pdc[(force > low) & (force < low + 0.5)]) for low in (0.0, 1.0, 2.0, 3.0, 4.0)]
    assert (np.diff(levels) > 0).all()
    assert levels[1] - levels[0] > 2 * (levels[4] - levels[3])


def test_vibration_rests_at_2042_and_answers_a_press(recording: Recording, force: np.ndarray) -> None:
    pac0 = recording.channels[:, 0]
    quiet = np.convolve(force > 0.06, np.ones(201), mode="same") == 0
    assert quiet.sum() > 100
    assert np.median(pac0[quiet]) == pytest.approx(2042, abs=10)
    assert 4.0 < np.diff(pac0)[quiet[1:]].std() / np.sqrt(2) < 6.0
    assert pac0.std() > 50


def test_temperature_rises_in_real_time(recording: Recording) -> None:
    tdc = recording.auxiliary["tdc"]
    assert tdc[:100].mean() == pytest.approx(1850, abs=1)
    assert 25 < tdc[-100:].mean() - tdc[:100].mean() < 40


def test_the_papers_recording_would_end_at_its_last_temperature() -> None:
    rows = 292_200
    tdc = tdc_counts(core_celsius(rows, np.zeros(rows)))
    assert tdc[-1] == pytest.approx(2040, abs=1)
    assert tdc.mean() == pytest.approx(1968.75, abs=3)
    np.testing.assert_allclose(tdc_counts(celsius(tdc[::10_000])), tdc[::10_000])


def test_it_is_as_hard_to_guess_as_the_papers_data(recording: Recording) -> None:
    assert 0.45 < summarise(recording)["mean_predictor_norm_mae"] < 0.65


def test_the_command_writes_what_the_twin_gives(tmp_path: Path) -> None:
    app = typer.Typer()
    app.command()(twin)
    output = tmp_path / "twin.csv"
    result = CliRunner().invoke(app, ["--rows", "500", "--seed", "3", "-o", str(output), "--json"])
    assert result.exit_code == 0
    assert json.loads(result.stdout)["rows"] == 500
    written, made = read_ruppel(output), simulate(500, 3)
    np.testing.assert_array_equal(written.channels, made.channels)
    np.testing.assert_allclose(written.samples.force, made.samples.force)
    np.testing.assert_array_equal(written.samples.time_ns, made.samples.time_ns)
