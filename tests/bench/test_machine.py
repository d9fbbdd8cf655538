"""What figures say of the machine and the code that they were measured on."""

import subprocess
from pathlib import Path

from taxel_bench.machine import commit_of, describe_machine


def git(folder: Path, *arguments: str) -> str:
    who = ("-c", "user.name=Someone", "-c", "user.email=someone@example.org")
    done = subprocess.run(
        ["git", "-C", folder, *who, *arguments], capture_output=True, text=True, check=True
    )
    return done.stdout.strip()


def test_a_checkouts_commit_is_named_and_whether_it_was_changed(tmp_path: Path) -> None:
    git(tmp_path, "init", "-q")
    assert commit_of(tmp_path) is None
    (tmp_path / "code.py").write_text("one")
    git(tmp_path, "add", ".")
    git(tmp_path, "commit", "-q", "-m", "One")
    git(tmp_path, "tag", "-a", "v1", "-m", "One")
    short = git(tmp_path, "rev-parse", "--short", "HEAD")
    (tmp_path / "figures.json").write_text("not tracked")
    assert commit_of(tmp_path) == {"hash": short, "dirty": False}
    (tmp_path / "code.py").write_text("two")
    assert commit_of(tmp_path) == {"hash": short, "dirty": True}


def test_a_package_inside_someone_elses_checkout_has_no_commit(tmp_path: Path) -> None:
    git(tmp_path, "init", "-q")
    git(tmp_path, "commit", "-q", "--allow-empty", "-m", "Theirs")
    (tmp_path / "site-packages").mkdir()
    assert commit_of(tmp_path / "site-packages") is None


def test_a_machine_is_described() -> None:
    assert {"cpu", "flags", "cores", "caches", "load", "versions", "commit"} <= set(describe_machine())
