"""BioTac slide folders: streams on one clock, what is dropped, and damage refused by file."""

import re
from pathlib import Path

import numpy as np
import pytest

from taxel.errors import RecordingError
from taxel_models.recordings import read_recording, read_slide
from taxel_models.recordings.slide import GLITCH, OUTSIDE

START_NS = 1_581_072_654_214_555_703
TACTILE = ("tdc", "tac", "pdc", *(f"pac{n}" for n in range(1, 23)), *(f"ele{n}" for n in range(1, 20)))
HEADERS = {"cp": "posx,posy,posz,ox,oy,oz, ow", "cv": "x,y,z,a,b,c", "cw": "fx,fy,fz,tx,ty,tz"}


def stamp(time_ns: int) -> str:
    return f"{time_ns // 10**9}.{time_ns % 10**9:09d}"


def counts(rows: int) -> np.ndarray:
    """Column j of row i holds i + j."""
    return np.arange(rows)[:, None] + np.arange(len(TACTILE))


def write_trial(
    folder: Path,
    material: int = 1,
    trial: int = 1,
    start_ns: int = START_NS,
    rows: int = 12,
    values: np.ndarray | None = None,
) -> None:
    """A trial whose robot streams run 3 ms behind and are linear in time; rows end in a comma."""
    folder.mkdir(exist_ok=True)
    name = f"mat{material}_{trial}"
    values = counts(rows) if values is None else values
    lines = [
        f"{stamp(start_ns + 10_000_000 * row)},{','.join(map(str, values[row]))}," for row in range(rows)
    ]
    (folder / f"{name}_bio.csv").write_text("\n".join([f"timestamp,{','.join(TACTILE)}", *lines, ""]))
    for stream, header in HEADERS.items():
        lines = []
        for message in range(rows):
            at_ms = 3 + 10 * message
            linear = [factor * at_ms / 1000 for factor in (1, 2, -1)]
            rest = ["-nan"] * 3 if stream == "cv" else ["0"] * (header.count(",") - 2)
            lines.append(",".join([stamp(start_ns + at_ms * 1_000_000), *map(str, linear), *rest]))
        (folder / f"{name}_{stream}.csv").write_text("\n".join([f"timestamp,{header}", *lines, ""]))


def test_a_trial_lies_on_the_tactile_clock_to_the_nanosecond(tmp_path: Path) -> None:
    write_trial(tmp_path)
    recording = read_slide(tmp_path)
    assert recording.samples.time_ns.tolist() == [START_NS + 10_000_000 * row for row in range(1, 12)]
    at_ms = 10.0 * np.arange(1, 12)
    linear = np.column_stack([at_ms, 2 * at_ms, -at_ms]) / 1000
    np.testing.assert_allclose(recording.samples.position, linear, rtol=1e-12)
    np.testing.assert_allclose(recording.samples.force, linear, rtol=1e-12)
    np.testing.assert_allclose(recording.covariates["velocity_y"], 2 * at_ms / 1000, rtol=1e-12)
    np.testing.assert_allclose(recording.covariates["robot_gap"], 0.01)
    assert recording.dropped == {OUTSIDE: 1}


def test_channels_take_their_columns_by_name(tmp_path: Path) -> None:
    write_trial(tmp_path)
    recording = read_slide(tmp_path)
    first = {name: 1 + TACTILE.index(name) for name in TACTILE}
    assert recording.channels[0, :3].tolist() == [first["pac1"], first["pdc"], first["ele1"]]
    assert recording.channels[0, 20] == first["ele19"]
    assert recording.auxiliary["pac1"][0] == first["pac2"]
    assert (recording.auxiliary["tac"][0], recording.auxiliary["tdc"][0]) == (first["tac"], first["tdc"])
    assert (recording.format, recording.name) == ("biotac_slide", tmp_path.name)


def test_trials_are_segments_in_the_order_of_their_start(tmp_path: Path) -> None:
    for material, trial, start_s in ((1, 1, 60), (1, 3, 120), (2, 1, 0)):
        write_trial(tmp_path / f"mat{material}", material, trial, START_NS + start_s * 10**9)
    recording = read_recording(tmp_path)
    firsts = [segment.start for segment in recording.segments]
    assert recording.covariates["material"][firsts].tolist() == [2, 1, 1]
    assert recording.covariates["trial"][firsts].tolist() == [1, 1, 3]
    assert len(read_slide(tmp_path / "mat1").segments) == 2


def test_the_fingerprint_is_of_every_file(tmp_path: Path) -> None:
    write_trial(tmp_path)
    before = read_slide(tmp_path).sha256
    assert read_slide(tmp_path).sha256 == before
    (tmp_path / "notes.txt").write_text("not part of it")
    assert read_slide(tmp_path).sha256 == before
    path = tmp_path / "mat1_1_cw.csv"
    path.write_text(path.read_text() + "\n")
    assert read_slide(tmp_path).sha256 != before


def test_glitches_are_dropped_and_counted_and_do_not_break_the_segment(tmp_path: Path) -> None:
    values = np.zeros((20, len(TACTILE)), int)
    values[7, TACTILE.index("ele4")] = 3061
    values[12:14, TACTILE.index("ele9")] = 1500
    write_trial(tmp_path, rows=20, values=values)
    recording = read_slide(tmp_path)
    assert recording.dropped == {OUTSIDE: 1, GLITCH: 3}
    assert len(recording) == 16
    assert recording.channels.max() == 0
    assert len(recording.segments) == 1


def test_a_glitch_outside_the_robot_streams_is_counted_once(tmp_path: Path) -> None:
    values = np.zeros((12, len(TACTILE)), int)
    values[0, TACTILE.index("ele1")] = 2000
    write_trial(tmp_path, values=values)
    assert read_slide(tmp_path).dropped == {OUTSIDE: 1}


def test_a_hole_in_a_robot_stream_shows_in_the_rows_across_it(tmp_path: Path) -> None:
    write_trial(tmp_path)
    path = tmp_path / "mat1_1_cw.csv"
    lines = path.read_text().splitlines()
    path.write_text("\n".join([*lines[:4], *lines[8:]]))
    gap = read_slide(tmp_path).covariates["robot_gap"]
    np.testing.assert_allclose(gap, [0.01, 0.01, *[0.05] * 5, *[0.01] * 4])


def test_progress_is_told_after_every_trial(tmp_path: Path) -> None:
    for trial in (1, 3):
        write_trial(tmp_path, trial=trial, start_ns=START_NS + trial * 10**9)
    told: list[tuple[int, int]] = []
    read_recording(tmp_path, lambda done, total: told.append((done, total)))
    assert told == [(1, 2), (2, 2)]


def test_a_folder_without_trials_is_refused(tmp_path: Path) -> None:
    (tmp_path / "mat1").mkdir()
    with pytest.raises(RecordingError, match=r"no trials; expected files like mat1_1_bio\.csv"):
        read_recording(tmp_path)


@pytest.mark.parametrize("stream", ["bio", "cp", "cv", "cw"])
def test_a_missing_stream_is_named(tmp_path: Path, stream: str) -> None:
    write_trial(tmp_path)
    path = tmp_path / f"mat1_1_{stream}.csv"
    path.unlink()
    with pytest.raises(RecordingError, match=f"^{re.escape(str(path))}: missing; expected four files"):
        read_slide(tmp_path)


@pytest.mark.parametrize(
    ("stream", "old", "new", "expected"),
    [
        ("bio", "ele7", "ele77", "1: no column 'ele7'; expected timestamp"),
        ("bio", ".224555703,", ".224555,", "3: column 'timestamp': '1581072654.224555' is not a time; exp"),
        ("bio", ".224555703,1,", ".224555703,x,", "3: column 'tdc': 'x' is not a number; expected"),
        ("bio", ".224555703,1,", ".224555703,", "3: 44 columns; expected 45"),
        ("bio", ".224555703,1,", ".214555703,1,", r"3: time \d+ ns follows \d+ ns; expected time to incr"),
        ("cw", "703,0.013,", "703,nan,", "3: column 'fx': nan is not finite; expected"),
        ("cv", "703,0.013,", "703,-nan,", "3: column 'x': nan is not finite; expected"),
        ("cp", ".227555703", ".200000000", r"3: time \d+ ns follows \d+ ns; expected time to increase"),
    ],
)
def test_a_damaged_stream_is_refused_with_file_line_and_expectation(
    tmp_path: Path, stream: str, old: str, new: str, expected: str
) -> None:
    write_trial(tmp_path)
    path = tmp_path / f"mat1_1_{stream}.csv"
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    with pytest.raises(RecordingError, match=f"^{re.escape(str(path))}:{expected}"):
        read_slide(tmp_path)


def test_streams_of_different_times_are_refused(tmp_path: Path) -> None:
    write_trial(tmp_path, start_ns=START_NS + 10**12)
    late = (tmp_path / "mat1_1_cp.csv").read_text()
    write_trial(tmp_path)
    (tmp_path / "mat1_1_cp.csv").write_text(late)
    with pytest.raises(RecordingError, match=r"mat1_1_bio\.csv: all 12 rows are outside the robot streams"):
        read_slide(tmp_path)


def test_trials_that_overlap_are_refused(tmp_path: Path) -> None:
    write_trial(tmp_path, trial=1)
    write_trial(tmp_path, trial=3, start_ns=START_NS + 50_000_000)
    with pytest.raises(
        RecordingError, match=r"mat1_3_bio\.csv: starts -0\.050 s after the end of mat1_1_bio"
    ):
        read_slide(tmp_path)
