"""`taxel recording`: summary, picture and conversion."""

import json
from pathlib import Path

import numpy as np
import pytest
import typer
from typer.testing import CliRunner, Result

from taxel.channels import CHANNELS
from taxel.commands.cli import failing_clearly
from taxel.errors import SettingsError
from taxel_models.commands.recording import recording as command
from taxel_models.recordings import Recording, read_ruppel, write_ruppel
from taxel_models.recordings.recording import AUXILIARY
from taxel_models.recordings.recording_plot import draw
from taxel_models.recordings.summary import summarise


def two_segments(rows: int = 60) -> Recording:
    """Rows at 100 Hz with a second's gap in the middle; `pdc` holds each value for two rows."""
    row = np.arange(rows)
    channels = np.tile(row.astype(float)[:, None], (1, len(CHANNELS)))
    channels[:, CHANNELS.index("pdc")] = row // 2
    return Recording.of(
        row * 10_000_000 + (row >= rows // 2) * 10**9,
        np.column_stack([row * 1e-4, np.zeros(rows), np.zeros(rows)]),
        np.tile([0.0, 3.0, 4.0], (rows, 1)),
        channels,
        {name: np.full(rows, 7.0) for name in AUXILIARY},
        {"material": np.full(rows, 2.0)},
        name="two",
        dropped={"electrode glitch": 3},
    )


def run(*arguments: str | Path) -> Result:
    app = typer.Typer(pretty_exceptions_enable=False)
    app.command()(failing_clearly(command))
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


def test_a_summary_counts_rows_segments_and_repeats() -> None:
    summary = summarise(two_segments())
    assert (summary.rows, summary.segments, summary.rate_hz) == (60, 2, 100)
    assert summary.seconds == pytest.approx(0.58)
    assert summary.dropped == {"electrode glitch": 3}
    assert summary.columns["channels"]["pdc"].repeats == pytest.approx(30 / 58)
    assert summary.columns["channels"]["e1"].repeats == 0
    assert summary.columns["auxiliary"]["tdc"].repeats == 1
    force = summary.columns["force"]["|f|"]
    assert (force.minimum, force.mean, force.maximum, force.sd) == (5, 5, 5, 0)
    assert summary.columns["channels"]["e1"].sd == pytest.approx(np.arange(60).std())
    assert list(summary.columns) == ["position", "force", "channels", "auxiliary", "covariates"]


def test_one_row_has_a_summary() -> None:
    summary = summarise(two_segments().rows(np.array([5])))
    assert (summary.rows, summary.segments, summary.seconds) == (1, 1, 0)


def test_the_command_prints_a_table_or_one_object(tmp_path: Path) -> None:
    path = tmp_path / "two.csv"
    write_ruppel(two_segments(), path)
    table = run(path)
    assert table.exit_code == 0
    assert all(
        word in table.stdout for word in ("two", "segments", "e19", "material", "100.00 Hz", "nothing")
    )
    answer = json.loads(run(path, "--json").stdout)
    assert (answer["rows"], answer["segments"], answer["format"], answer["dropped"]) == (
        60,
        2,
        "ruppel",
        {},
    )
    assert answer["columns"]["channels"]["e1"]["maximum"] == 59
    assert answer["sha256"] == read_ruppel(path).sha256


def test_the_command_converts_and_draws(tmp_path: Path) -> None:
    path, copy, picture = (tmp_path / name for name in ("two.csv", "copy.csv", "two.png"))
    write_ruppel(two_segments(), path)
    assert run(path, "-o", copy, "--plot", picture).exit_code == 0
    assert copy.read_bytes() == path.read_bytes()
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_a_damaged_recording_leaves_the_outputs_as_they_were(tmp_path: Path) -> None:
    path, copy, picture = (tmp_path / name for name in ("two.csv", "copy.csv", "two.png"))
    write_ruppel(two_segments(), path)
    path.write_text(path.read_text() + "1,2\n")
    for output in (copy, picture):
        output.write_text("old")
    result = run(path, "-o", copy, "--plot", picture)
    assert result.exit_code == 1
    assert "two.csv:62: 2 columns; expected 32" in result.stderr
    assert copy.read_text() == picture.read_text() == "old"


@pytest.mark.parametrize(
    ("rows", "suffix"), [(1, "png"), (60, "png"), (4000, "png"), (60, "pdf"), (60, "svg")]
)
def test_a_recording_of_any_length_is_drawn(tmp_path: Path, rows: int, suffix: str) -> None:
    path = tmp_path / f"picture.{suffix}"
    draw(two_segments(max(rows, 2)).rows(np.arange(rows)), path)
    assert path.stat().st_size > 5000
    assert list(tmp_path.iterdir()) == [path]


def test_an_unknown_kind_of_picture_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "picture.gif"
    path.write_text("old")
    with pytest.raises(SettingsError, match=r"cannot draw a \.gif; expected \.png, \.pdf or \.svg"):
        draw(two_segments(), path)
    assert path.read_text() == "old"
