"""Causes that are planted in files, and the files."""

from pathlib import Path

import numpy as np
import pytest

from taxel.channels import CHANNELS
from taxel.errors import RecordingError
from taxel_bench.planted.causes import ELECTRODES, EVERY, PLANTED, Planting
from taxel_bench.planted.measurement import PLAYED, TRAINED_ON, Planted
from taxel_bench.planted.trials import Tables, Trial, found_in
from taxel_models.loop.effects.registry import NAMES
from taxel_models.recordings import read_slide

COLUMNS = ("tdc", "tac", "pdc", *(f"pac{n}" for n in range(1, 23)), *(f"ele{n}" for n in range(1, 20)))
ROWS = 300


def planting(seed: int = 0) -> Planting:
    """Two trials of tared channels."""
    random = np.random.default_rng(5)
    press = np.maximum(np.sin(np.arange(2 * ROWS) / 40.0), 0.0)
    return Planting(
        counts=np.rint(press[:, None] * random.uniform(5.0, 40.0, size=21)),
        trial=np.repeat([0, 1], ROWS),
        time_s=np.arange(2 * ROWS) / 100.0,
        force_n=4.0 * press,
        tdc=np.arange(2 * ROWS) * 0.1,
        random=np.random.default_rng(seed),
    )


@pytest.mark.parametrize("cause", PLANTED)
def test_a_cause_changes_electrodes_alike_for_the_same_seed(cause: str) -> None:
    before, one, again, other = planting(), planting(), planting(), planting(1)
    for each in (one, again, other):
        PLANTED[cause][0](each)
    changed = (one.counts != before.counts).any(axis=0)
    assert changed[ELECTRODES].any()
    np.testing.assert_array_equal(one.counts, again.counts)
    if not cause.startswith("delay"):
        assert not changed[:2].any()
        assert (one.counts != other.counts).any()
    assert PLANTED[cause][1].partition(":")[0] in NAMES


def test_a_delay_shows_what_was_before_in_the_same_trial() -> None:
    before, one = planting(), planting()
    PLANTED["delay 20 ms"][0](one)
    np.testing.assert_array_equal(one.counts[2:ROWS], before.counts[: ROWS - 2])
    np.testing.assert_array_equal(one.counts[ROWS + 2 :], before.counts[ROWS:-2])
    np.testing.assert_array_equal(one.counts[ROWS : ROWS + 2], before.counts[[ROWS, ROWS]])


def test_a_fading_electrode_ends_at_less_of_its_signal() -> None:
    before, one = planting(), planting()
    PLANTED["fading"][0](one)
    (column,) = np.flatnonzero((one.counts != before.counts).any(axis=0))
    kept = (one.counts - one.rest)[-ROWS:, column].sum() / (before.counts - before.rest)[
        -ROWS:, column
    ].sum()
    assert 0.29 < kept < 0.6


def write(folder: Path, trial: Trial, start_s: float, counts: np.ndarray) -> None:
    path = trial.file(folder, "bio")
    path.parent.mkdir(parents=True, exist_ok=True)
    times = [f"{start_s + 0.01 * row:.9f}" for row in range(len(counts))]

    def text(names: str, values: np.ndarray) -> str:
        rows = (f"{time},{','.join(map(str, row))}" for time, row in zip(times, values, strict=True))
        return "\n".join([f"timestamp,{names}", *rows, ""])

    path.write_text(text(",".join(COLUMNS), counts))
    robot = np.zeros((len(counts), 6))
    robot[:, 2] = -1.0
    for kind, names in (
        ("cp", "posx,posy,posz,ox,oy,oz"),
        ("cv", "x,y,z,a,b,c"),
        ("cw", "fx,fy,fz,tx,ty,tz"),
    ):
        trial.file(folder, kind).write_text(text(names, robot))


def test_files_with_planted_counts_are_recordings(tmp_path: Path) -> None:
    random = np.random.default_rng(2)
    trials = [Trial(3, 1), Trial(12, 7)]
    for number, trial in enumerate(trials):
        values = random.integers(0, 50, size=(40, len(COLUMNS)))
        write(tmp_path / "data", trial, 1000.0 - 100.0 * number, values)
    assert found_in(tmp_path / "data") == trials
    tables = Tables(trials, tmp_path / "data")
    one = tables.planting(np.random.default_rng(1))
    # The second trial was earlier.
    assert one.time_s[0] == 900.0
    np.testing.assert_allclose(one.force_n, 1.0)
    one.counts = one.counts - 20.3
    tables.write(one, tmp_path / "planted")
    recording = read_slide(tmp_path / "planted")
    expected = np.clip(np.rint(one.counts), 0, 4095)
    assert recording.channels.shape[1] == len(CHANNELS)
    for material, number in ((12.0, 0), (3.0, 1)):
        rows = recording.covariates["material"] == material
        found, own = recording.channels[rows], expected[one.trial == number]
        np.testing.assert_array_equal(found, own[-len(found) :])


def test_a_folder_without_trials_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"no trials; expected files such as mat1/mat1_1_bio\.csv"):
        found_in(tmp_path)


def test_a_model_is_trained_on_other_trials_than_those_that_are_played(tmp_path: Path) -> None:
    for number in range(TRAINED_ON + 3):
        values = np.full((40, len(COLUMNS)), number)
        write(tmp_path / "data", Trial(1, number), 100.0 * number, values)
    asked = Planted(tmp_path / "data", tmp_path / "work", seed=4)
    trained = {trial.number for trial in found_in(tmp_path / "work" / "trained_on")}
    played = set(asked.recording(()).counts[:, 5])
    assert len(trained) == TRAINED_ON
    assert played == {*range(TRAINED_ON + 3)} - trained
    assert len(played) < PLAYED
    assert len(set(EVERY)) == len(EVERY)
