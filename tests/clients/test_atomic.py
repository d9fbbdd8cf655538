"""Files and folders appear whole or not at all."""

import json
import os
from pathlib import Path

import pytest

from taxel.atomic import (
    check_file_place,
    check_folder_place,
    whole_file,
    whole_folder,
    write_json,
    write_text,
)
from taxel.errors import SettingsError


def test_a_file_takes_its_place_when_done(tmp_path: Path) -> None:
    path = tmp_path / "out.csv"
    path.write_text("old")
    with whole_file(path) as temporary:
        temporary.write_text("new")
        assert path.read_text() == "old"
    assert path.read_text() == "new"
    assert list(tmp_path.iterdir()) == [path]


def test_a_failed_file_leaves_the_old_one(tmp_path: Path) -> None:
    path = tmp_path / "out.csv"
    path.write_text("old")
    with pytest.raises(RuntimeError), whole_file(path) as temporary:
        temporary.write_text("half")
        raise RuntimeError
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_link_stays_one_and_its_file_is_replaced(tmp_path: Path) -> None:
    (tmp_path / "there").mkdir()
    path, link = tmp_path / "there" / "out.csv", tmp_path / "link.csv"
    path.write_text("old")
    link.symlink_to(path)
    write_text(link, "new")
    assert link.is_symlink()
    assert path.read_text() == "new"
    assert [each.name for each in path.parent.iterdir()] == ["out.csv"]
    path.unlink()
    write_text(link, "again")
    assert (link.is_symlink(), path.read_text()) == (True, "again")


def test_a_device_or_a_pipe_is_not_replaced(tmp_path: Path) -> None:
    pipe, link = tmp_path / "pipe", tmp_path / "link"
    os.mkfifo(pipe)
    link.symlink_to(os.devnull)
    for place in (pipe, link):
        with pytest.raises(SettingsError, match="is a device or a pipe: expected the name of a file"):
            write_text(place, "new")
    assert pipe.is_fifo()
    assert link.is_char_device()


def test_a_file_in_no_folder_is_refused(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match="does not exist"), whole_file(tmp_path / "none" / "out.csv"):
        pass


def test_what_is_read_is_not_overwritten(tmp_path: Path) -> None:
    recording = tmp_path / "recording.csv"
    recording.write_text("mine")
    (tmp_path / "link.csv").symlink_to(recording)
    for place in (recording, tmp_path / "link.csv"):
        with pytest.raises(SettingsError, match="is what is read: expected another place"):
            check_file_place(place, reads=recording)
    with pytest.raises(SettingsError, match="is what is read"):
        check_file_place(recording, reads=tmp_path)
    check_file_place(tmp_path / "other.csv", reads=recording)
    check_file_place(recording, reads=tmp_path / "missing.csv")
    assert recording.read_text() == "mine"


@pytest.mark.skipif(not Path("/proc").is_dir(), reason="a folder that takes no file")
def test_a_place_that_takes_no_file_is_refused_before_any_work() -> None:
    for check, place in ((check_file_place, Path("/proc/out")), (check_folder_place, Path("/proc/out"))):
        with pytest.raises(SettingsError, match="/proc/out: nothing can be written in /proc: "):
            check(place)


def test_text_and_json_are_written_whole(tmp_path: Path) -> None:
    path = tmp_path / "out.json"
    write_json(path, {"a": [1, 2.5]})
    assert json.loads(path.read_bytes()) == {"a": [1, 2.5]}
    with pytest.raises(ValueError, match="not JSON compliant"):
        write_json(path, {"a": float("nan")})
    assert json.loads(path.read_bytes()) == {"a": [1, 2.5]}
    write_text(path, "12 µs\n")
    assert path.read_bytes() == "12 µs\n".encode()
    assert list(tmp_path.iterdir()) == [path]


def test_a_folder_takes_its_place_when_done(tmp_path: Path) -> None:
    path = tmp_path / "deep" / "out"
    with whole_folder(path) as temporary:
        (temporary / "a").write_text("1")
        assert not path.exists()
    assert [child.name for child in path.iterdir()] == ["a"]


def test_a_folder_is_only_replaced_when_asked_and_then_whole(tmp_path: Path) -> None:
    path = tmp_path / "out"
    path.mkdir()
    (path / "old").write_text("1")
    with pytest.raises(SettingsError, match=r"exists already: choose another place$"):
        check_folder_place(path)
    with pytest.raises(SettingsError, match=r"exists already: choose another place, or pass --overwrite$"):
        check_folder_place(path, replacing="old", overwrite=False)
    with whole_folder(path, replacing="old") as temporary:
        (temporary / "new").write_text("2")
    assert [child.name for child in path.iterdir()] == ["new"]
    assert list(tmp_path.iterdir()) == [path]


def test_a_failed_folder_leaves_the_old_one(tmp_path: Path) -> None:
    path = tmp_path / "out"
    path.mkdir()
    (path / "old").write_text("1")
    with pytest.raises(RuntimeError), whole_folder(path, replacing="old") as temporary:
        (temporary / "new").write_text("2")
        raise RuntimeError
    assert [child.name for child in path.iterdir()] == ["old"]
    assert list(tmp_path.iterdir()) == [path]


def test_what_is_not_ours_is_never_replaced(tmp_path: Path) -> None:
    precious = tmp_path / "precious"
    precious.mkdir()
    (precious / "thesis.txt").write_text("years")
    with pytest.raises(SettingsError, match=r"holds no errors\.json: it is not ours to replace"):
        check_folder_place(precious, replacing="errors.json")
    with pytest.raises(SettingsError, match="is a file"):
        check_folder_place(precious / "thesis.txt", replacing="errors.json")
    with pytest.raises(SettingsError, match="is a folder"):
        check_file_place(precious)
    assert (precious / "thesis.txt").read_text() == "years"


def test_no_folder_can_stand_below_a_file(tmp_path: Path) -> None:
    (tmp_path / "notes").write_text("old")
    for place in (tmp_path / "notes" / "out", tmp_path / "notes" / "deep" / "out"):
        with pytest.raises(SettingsError, match=r"notes is a file: expected a folder"):
            check_folder_place(place)
