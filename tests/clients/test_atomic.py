"""Files and folders appear whole or not at all."""

from pathlib import Path

import pytest

from taxel.atomic import check_free, whole_file, whole_folder
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


def test_a_file_in_no_folder_is_refused(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match="does not exist"), whole_file(tmp_path / "none" / "out.csv"):
        pass


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
    with pytest.raises(SettingsError, match="exists already"):
        check_free(path)
    with whole_folder(path, overwrite=True) as temporary:
        (temporary / "new").write_text("2")
    assert [child.name for child in path.iterdir()] == ["new"]
    assert list(tmp_path.iterdir()) == [path]


def test_a_failed_folder_leaves_the_old_one(tmp_path: Path) -> None:
    path = tmp_path / "out"
    path.mkdir()
    (path / "old").write_text("1")
    with pytest.raises(RuntimeError), whole_folder(path, overwrite=True) as temporary:
        (temporary / "new").write_text("2")
        raise RuntimeError
    assert [child.name for child in path.iterdir()] == ["old"]
    assert list(tmp_path.iterdir()) == [path]
