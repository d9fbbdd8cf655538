"""What looks wrong in a recording is told by name; a twin's recording looks right."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import typer
from hypothesis import given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner, Result

from taxel.channels import CHANNELS
from taxel.commands.cli import failing_clearly
from taxel.errors import InputWarning, RecordingError
from taxel_models.commands.recording import recording as command
from taxel_models.recordings import Recording, read_recording, write_ruppel
from taxel_models.recordings.findings import check_units, recording_findings
from taxel_models.recordings.glitches import GLITCH_ROWS, jumps
from taxel_models.twin import simulate

TWINS = [simulate(12_000, seed) for seed in range(20, 23)]
STRETCHES = st.tuples(st.integers(0, 2), st.integers(0, 5)).map(
    lambda place: TWINS[place[0]].rows(slice(2000 * place[1], 2000 * (place[1] + 1)))
)


def names(recording: Recording) -> list[str]:
    return [finding.name for finding in recording_findings(recording)]


def with_samples(recording: Recording, **columns: object) -> Recording:
    samples = recording.samples
    given = {"time_ns": samples.time_ns, "position": samples.position, "force": samples.force, **columns}
    return Recording.of(**given, channels=recording.channels, auxiliary=recording.auxiliary)  # type: ignore[arg-type]


def in_millimetres(recording: Recording) -> Recording:
    return with_samples(recording, position=recording.samples.position * 1e3)


def in_grams(recording: Recording) -> Recording:
    return with_samples(recording, force=recording.samples.force / 9.80665e-3)


def flipped(recording: Recording) -> Recording:
    return with_samples(recording, force=-recording.samples.force)


def in_milliseconds(recording: Recording) -> Recording:
    return with_samples(recording, time_ns=recording.samples.time_ns // 1_000_000)


def in_microseconds(recording: Recording) -> Recording:
    return with_samples(recording, time_ns=recording.samples.time_ns // 1000)


def every_tenth(recording: Recording) -> Recording:
    tenth = recording.rows(np.arange(0, len(recording), 10))
    return with_samples(tenth)


def with_a_glitch(recording: Recording) -> Recording:
    channels = recording.channels.copy()
    channels[700:702, CHANNELS.index("e7")] = 0.0
    return replace(recording, channels=channels)


def with_a_dead_channel(recording: Recording) -> Recording:
    channels = recording.channels.copy()
    channels[:, CHANNELS.index("e3")] = 2000.0
    return replace(recording, channels=channels)


def with_a_still_channel(recording: Recording) -> Recording:
    channels = recording.channels.copy()
    channels[:, CHANNELS.index("e4")] = 2000.0 + np.arange(len(recording)) % 3
    return replace(recording, channels=channels)


def without_lower_bits(recording: Recording) -> Recording:
    return replace(recording, channels=recording.channels // 4 * 4)


def without_touch(recording: Recording) -> Recording:
    return with_samples(recording, force=0.01 * recording.samples.force)


def in_volts(recording: Recording) -> Recording:
    return replace(recording, channels=recording.channels - 3000.0)


@given(STRETCHES)
@settings(max_examples=18, deadline=None)
def test_a_twins_recording_looks_right(recording: Recording) -> None:
    assert names(recording) == []


@given(
    STRETCHES,
    st.sampled_from(
        [
            (in_millimetres, "millimetres"),
            (in_grams, "grams"),
            (flipped, "wrong sign"),
            (in_milliseconds, "milliseconds"),
            (in_microseconds, "microseconds"),
            (every_tenth, "rate"),
            (with_a_glitch, "glitches"),
            (with_a_dead_channel, "constant channels"),
            (with_a_still_channel, "still channels"),
            (in_volts, "counts"),
            (without_lower_bits, "coarse counts"),
            (without_touch, "no touch"),
        ]
    ),
)
@settings(max_examples=60, deadline=None)
def test_a_mistake_is_told_by_name(
    recording: Recording, mistake: tuple[Callable[[Recording], Recording], str]
) -> None:
    change, name = mistake
    assert name in names(change(recording))


def test_two_mistakes_are_both_told() -> None:
    assert {"millimetres", "milliseconds"} <= set(names(in_milliseconds(in_millimetres(TWINS[0]))))


@pytest.mark.parametrize("length", range(1, GLITCH_ROWS + 1))
@pytest.mark.parametrize("height", [900.0, -900.0])
def test_a_jump_far_away_and_back_is_found_where_it_is(length: int, height: float) -> None:
    channels = np.random.default_rng(0).normal(2000.0, 3.0, (5000, 2))
    channels[60 : 60 + length, 1] += height
    found = np.argwhere(jumps(channels)).tolist()
    assert found == [[row, 1] for row in range(60, 60 + length)]


@pytest.mark.parametrize("rows", [100, 600, 3000])
def test_glitches_do_not_hide_each_other(rows: int) -> None:
    channels = np.random.default_rng(0).normal(2000.0, 3.0, (rows, 2))
    wrong = np.arange(20, rows, max(rows // 4, 100))
    channels[wrong, 1] += 900.0
    assert np.argwhere(jumps(channels)).tolist() == [[row, 1] for row in wrong.tolist()]


def test_a_step_that_stays_and_a_restless_channel_are_no_glitches() -> None:
    channels = np.random.default_rng(0).normal(2000.0, 3.0, (5000, 2))
    channels[60:, 0] += 900.0
    channels[:, 1] += 900.0 * (np.arange(5000) % 7 == 0)
    assert not jumps(channels).any()
    assert not jumps(channels[:2]).any()


def test_slide_recordings_are_in_another_frame() -> None:
    moved = with_samples(TWINS[0], position=TWINS[0].samples.position + 0.5)
    assert names(moved) == ["off the skin"]
    slide = replace(moved, format="biotac_slide")
    assert names(slide) == []
    assert names(flipped(moved)) != []
    assert names(replace(flipped(moved), format="biotac_slide")) == []
    assert names(replace(in_millimetres(slide), format="biotac_slide")) == ["millimetres"]
    assert "grams" in names(replace(in_grams(slide), format="biotac_slide"))


def test_units_are_judged_by_most_samples() -> None:
    check_units(TWINS[0], None)
    with pytest.raises(RecordingError, match="most places are in millimetres: expected metres"):
        check_units(in_millimetres(TWINS[0]), None)
    with pytest.raises(RecordingError, match="most forces are in grams: expected newtons"):
        check_units(in_grams(TWINS[0]), None)
    position, force = TWINS[0].samples.position.copy(), TWINS[0].samples.force.copy()
    touched = np.flatnonzero(np.linalg.norm(force, axis=1) > 1.0)
    position[touched[:50]] *= 1e3
    force[touched[-50:]] *= 1e3
    for glitches in (with_samples(TWINS[0], position=position), with_samples(TWINS[0], force=force)):
        assert {"millimetres", "millinewtons"} & set(names(glitches))
        check_units(glitches, None)
    # Nothing is touched.
    check_units(with_samples(TWINS[0], force=0.0 * force, position=1e3 * position), None)


def test_reading_warns_and_is_strict_if_asked(tmp_path: Path) -> None:
    path = tmp_path / "mm.csv"
    write_ruppel(in_millimetres(TWINS[0]), path)
    with pytest.warns(InputWarning, match=r"mm: .* look like millimetres"):
        recording = read_recording(path)
    assert len(recording) == len(TWINS[0])
    write_ruppel(in_milliseconds(in_millimetres(TWINS[0])), path)
    with pytest.raises(RecordingError, match=r"look like milliseconds.*; .*look like millimetres"):
        read_recording(path, strict=True)
    write_ruppel(in_millimetres(TWINS[0]), path)
    # A path may be text.
    with pytest.raises(RecordingError, match=r"mm: .* look like millimetres"):
        read_recording(str(path), strict=True)


def run(*arguments: str) -> Result:
    app = typer.Typer(pretty_exceptions_enable=False)
    app.command()(failing_clearly(command))
    return CliRunner().invoke(app, arguments)


def test_the_command_says_what_looks_wrong(tmp_path: Path) -> None:
    path = tmp_path / "ms.csv"
    write_ruppel(in_milliseconds(TWINS[0].rows(slice(0, 2000))), path)
    assert "times that grow by 10 look like milliseconds" in run(str(path)).stdout.replace("\n", " ")
    found = json.loads(run(str(path), "--json").stdout)["findings"]
    assert [finding["name"] for finding in found] == ["milliseconds"]
    strict = run(str(path), "--strict")
    assert strict.exit_code == 1
    assert "look like milliseconds" in strict.stderr
