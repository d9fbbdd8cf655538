"""Ruppel CSV files read back equal, and damaged ones are refused by line."""

import hashlib
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from taxel.errors import RecordingError, SettingsError
from taxel_models.recordings import Recording, read_recording, read_ruppel, write_ruppel
from taxel_models.recordings.recording import AUXILIARY
from taxel_models.recordings.ruppel import COLUMNS

FINITE = st.floats(allow_nan=False, allow_infinity=False)
NAMES = st.text(st.characters(categories=("L", "N")), min_size=1, max_size=8)


@st.composite
def recordings(draw: st.DrawFn) -> Recording:
    rows = draw(st.integers(1, 6))
    steps = draw(st.lists(st.integers(1, 2**40), min_size=rows, max_size=rows))
    column = hnp.arrays(float, rows, elements=FINITE | st.integers(0, 4095).map(float))
    names = draw(st.lists(NAMES, max_size=3, unique=True))
    return Recording.of(
        draw(st.integers(-(2**61), 2**61)) + np.cumsum(np.array(steps, np.int64)),
        draw(hnp.arrays(float, (rows, 3), elements=FINITE)),
        draw(hnp.arrays(float, (rows, 3), elements=FINITE)),
        draw(hnp.arrays(float, (rows, 21), elements=FINITE | st.just(-0.0))),
        {name: draw(column) for name in AUXILIARY},
        {name: draw(column) for name in names},
    )


def small(**covariates: list[float]) -> Recording:
    rows = 4
    counts = np.arange(rows * 21, dtype=float).reshape(rows, 21)
    return Recording.of(
        1_518_709_123_456_789_012 + 10_000_000 * np.arange(rows),
        np.linspace(-0.01, 0.02, rows * 3).reshape(rows, 3),
        np.linspace(-1, 5, rows * 3).reshape(rows, 3),
        counts,
        {name: counts[:, 0] + offset for offset, name in enumerate(AUXILIARY)},
        covariates,
    )


def assert_equal(found: Recording, expected: Recording) -> None:
    def columns(recording: Recording) -> dict[str, bytes]:
        samples = recording.samples
        named = {
            "time": samples.time_ns,
            "position": samples.position,
            "force": samples.force,
            "channels": recording.channels,
            **recording.auxiliary,
            **{f"covariate {name}": values for name, values in recording.covariates.items()},
        }
        return {name: np.ascontiguousarray(values).tobytes() for name, values in named.items()}

    assert columns(found) == columns(expected)
    assert list(found.covariates) == list(expected.covariates)
    assert found.segments == expected.segments


@given(recording=recordings())
@settings(max_examples=60, deadline=None)
def test_a_written_recording_reads_back_bit_for_bit(
    recording: Recording, tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = tmp_path_factory.mktemp("round") / "trip.csv"
    write_ruppel(recording, path)
    assert_equal(read_ruppel(path), recording)


def test_the_file_has_the_published_header_and_whole_counts(tmp_path: Path) -> None:
    path = tmp_path / "one.csv"
    write_ruppel(small(material=[3, 3, 4, 4]), path)
    header, first = path.read_text().split("\n")[:2]
    assert header == ",".join((*COLUMNS, "material"))
    assert len(COLUMNS) == 31
    assert header.startswith(
        "%time,field.position.x,field.position.y,field.position.z,field.wrench.force.x,"
    )
    assert "field.tactiles0.pac0,field.tactiles0.pac1,field.tactiles0.pdc,field.tactiles0.tac," in header
    assert header.endswith("field.tactiles0.tdc," + ",".join(COLUMNS[12:]) + ",material")
    fields = first.split(",")
    assert fields[0] == "1518709123456789012"
    assert fields[1] == "-0.01"
    assert fields[12:] == [*(str(count) for count in range(2, 21)), "3"]


def test_columns_come_in_any_order_and_the_rest_are_covariates(tmp_path: Path) -> None:
    path = tmp_path / "turned.csv"
    write_ruppel(small(heat=[1, 2, 3, 4.5]), path)
    turned = [",".join(reversed(line.split(","))) for line in path.read_text().splitlines()]
    path.write_text("\n".join(turned))
    assert_equal(read_ruppel(path), small(heat=[1, 2, 3, 4.5]))


@pytest.mark.parametrize(
    "change",
    [
        lambda text: text.replace("\n", "\r\n"),
        lambda text: "\ufeff" + text,
        lambda text: text + "\n\n",
        lambda text: text.rstrip("\n"),
    ],
    ids=["CRLF", "byte order mark", "empty lines at the end", "no last line end"],
)
def test_harmless_differences_do_not_matter(tmp_path: Path, change: Callable[[str], str]) -> None:
    path = tmp_path / "one.csv"
    write_ruppel(small(), path)
    path.write_bytes(change(path.read_text()).encode())
    assert_equal(read_ruppel(path), small())


@pytest.mark.filterwarnings("ignore::taxel.errors.InputWarning")
def test_a_recording_remembers_its_file(tmp_path: Path) -> None:
    path = tmp_path / "night_run.csv"
    write_ruppel(small(), path)
    recording = read_recording(path)
    assert (recording.name, recording.format) == ("night_run", "ruppel")
    assert recording.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()


def test_one_row_is_a_recording(tmp_path: Path) -> None:
    path = tmp_path / "one.csv"
    single = small(heat=[1, 2, 3, 4]).rows(np.array([2]))
    write_ruppel(single, path)
    assert_equal(read_ruppel(path), single)


def _set(line: int, column: str, value: str) -> Callable[[str], str]:
    def damage(text: str) -> str:
        lines = [row.split(",") for row in text.splitlines()]
        lines[line - 1][COLUMNS.index(column)] = value
        return "\n".join(",".join(row) for row in lines)

    return damage


def _line(line: int, change: Callable[[str], str]) -> Callable[[str], str]:
    def damage(text: str) -> str:
        lines = text.splitlines()
        lines[line - 1] = change(lines[line - 1])
        return "\n".join(lines)

    return damage


E5 = "field.tactiles0.electrodes4"
DAMAGES: dict[str, tuple[Callable[[str], str], str]] = {
    "missing column": (lambda text: text.replace(E5, "e5"), rf"1: no column '{E5}'; expected %time"),
    "a comment first": (lambda text: f"# by hand\n{text}", "1: begins '# by hand': expected the names of"),
    "semicolons": (
        lambda text: text.replace(",", ";"),
        "1: begins '%time;.*': expected commas between the columns",
    ),
    "no header at all": (_line(1, lambda _: "1,2,3"), "1: begins '1,2,3': expected a header with"),
    "text in a number": (
        _set(3, E5, "abc"),
        rf"3: column '{E5}': 'abc' is not a number; expected a finite number",
    ),
    "empty field": (_set(5, E5, ""), rf"5: column '{E5}': '' is not a number; expected"),
    "text in a time": (
        _set(4, "%time", "noon"),
        "4: column '%time': 'noon' is not a time; expected a whole",
    ),
    "time as a float": (_set(4, "%time", "1.5e18"), "4: column '%time': '1.5e18' is not a time; expected"),
    "time beyond int64": (_set(5, "%time", "9" * 19), "5: column '%time': '9+' is not a time; expected"),
    "time beyond measure": (_set(5, "%time", "9" * 60), "5: column '%time': '9+' is not a time; expected"),
    "time going backwards": (
        _set(4, "%time", "1518709123456789000"),
        r"4: time 1518709123456789000 ns follows \d+ ns; expected time to increase",
    ),
    "time standing still": (
        _set(3, "%time", "1518709123456789012"),
        r"3: time \d+ ns follows \d+ ns; expected time to increase",
    ),
    "a column too few": (_line(4, lambda row: row.rpartition(",")[0]), "4: 30 columns; expected 31"),
    "a column too many": (_line(2, lambda row: row + ",7"), "2: 32 columns; expected 31"),
    "empty line between": (_line(3, lambda _: ""), "3: 1 columns; expected 31"),
    "NaN": (_set(5, E5, "nan"), rf"5: column '{E5}': nan is not finite; expected a finite number"),
    "infinity": (_set(2, E5, "-inf"), rf"2: column '{E5}': -inf is not finite; expected a finite number"),
    "overflow": (_set(2, E5, "1e999"), rf"2: column '{E5}': inf is not finite; expected a finite number"),
    "empty": (lambda _: "", "1: empty; expected a header with the columns %time"),
    "header only": (lambda text: text.splitlines()[0], "2: the file ends after its header; expected"),
    "covariate twice": (
        lambda text: "\n".join(
            f"{line},a,a" if "%" in line else f"{line},1,1" for line in text.splitlines()
        ),
        "1: column 'a' stands there twice; expected each name once",
    ),
    "nameless column": (
        lambda text: "\n".join(f"{line}," if "%" in line else f"{line},1" for line in text.splitlines()),
        "1: column 32 has no name; expected",
    ),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_file_is_refused_with_file_line_and_expectation(tmp_path: Path, damage: str) -> None:
    path = tmp_path / "damaged.csv"
    write_ruppel(small(), path)
    change, expected = DAMAGES[damage]
    path.write_text(change(path.read_text()))
    with pytest.raises(RecordingError, match=f"^{re.escape(str(path))}:{expected}"):
        read_ruppel(path)


@given(
    field=st.text(st.characters(exclude_characters=",", exclude_categories=["Cs"]))
    | st.from_regex(
        r"\s?[-+]?[0-9_.]+([eEpP][-+]?[0-9]+)?\s?|[-+]?(nan|inf|0x1p3|infinity)", fullmatch=True
    ),
    column=st.sampled_from(["%time", E5]),
)
@settings(max_examples=150, deadline=None)
def test_any_text_in_a_field_is_read_or_refused_by_line(
    field: str, column: str, tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = tmp_path_factory.mktemp("field") / "one.csv"
    write_ruppel(small(), path)
    path.write_bytes(_set(5, column, field)(path.read_text()).encode())
    try:
        read_ruppel(path)
        return
    except RecordingError as error:
        refusal = str(error)
    assert re.match(rf"{re.escape(str(path))}:[5-7]: .*expected", refusal)


def test_the_first_of_several_faults_is_named(tmp_path: Path) -> None:
    path = tmp_path / "damaged.csv"
    write_ruppel(small(), path)
    path.write_text(_set(5, E5, "x")(_set(3, "field.position.y", "y")(path.read_text())))
    with pytest.raises(RecordingError, match=r":3: column 'field\.position\.y': 'y' is not a number"):
        read_ruppel(path)


def test_bytes_that_are_no_text_are_refused_by_line(tmp_path: Path) -> None:
    path = tmp_path / "damaged.csv"
    write_ruppel(small(), path)
    path.write_bytes(path.read_bytes().replace(b"\n", b"\xff\n", 2))
    with pytest.raises(RecordingError, match=r":1: byte 0xff is not UTF-8; expected text"):
        read_ruppel(path)


def test_a_file_that_is_not_there_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"none\.csv: does not exist; expected a Ruppel CSV file, a"):
        read_recording(tmp_path / "none.csv")
    with pytest.raises(RecordingError, match=r"none\.csv: cannot be read: .*; expected a CSV file"):
        read_ruppel(tmp_path / "none.csv")


@pytest.mark.parametrize("name", ["", "a,b", 'a"b', "a\nb", " a", "%time", "\ud800"])
def test_a_name_that_no_header_holds_is_refused_and_the_old_file_stays(tmp_path: Path, name: str) -> None:
    path = tmp_path / "out.csv"
    path.write_text("old")
    with pytest.raises(RecordingError, match="cannot be a column's name; expected"):
        write_ruppel(small(**{name: [1, 2, 3, 4]}), path)
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_no_rows_are_refused_and_the_old_file_stays(tmp_path: Path) -> None:
    path = tmp_path / "out.csv"
    path.write_text("old")
    with pytest.raises(RecordingError, match="has no rows; expected at least one"):
        write_ruppel(small().rows(np.zeros(4, bool)), path)
    assert path.read_text() == "old"


def test_a_place_that_cannot_be_written_is_refused(tmp_path: Path) -> None:
    (tmp_path / "folder.csv").mkdir()
    with pytest.raises(SettingsError, match="is a folder"):
        write_ruppel(small(), tmp_path / "folder.csv")
    with pytest.raises(SettingsError, match="does not exist"):
        write_ruppel(small(), tmp_path / "none" / "out.csv")
    assert [path.name for path in tmp_path.iterdir()] == ["folder.csv"]


def test_columns_without_names_are_told() -> None:
    given = small()
    samples = given.samples
    with pytest.raises(RecordingError, match="auxiliary is a ndarray: expected columns by name"):
        Recording.of(
            samples.time_ns,
            samples.position,
            samples.force,
            given.channels,
            np.zeros((4, 3)),  # type: ignore[arg-type]
        )
