"""The lines of README and docs that begin with `make`: run in a copy of the checkout, long ones dry."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Final

import pytest

from .blocks import ALL, ROOT, joined_lines

LINES: Final = sorted(
    {
        line.partition("#")[0].strip()
        for block in ALL
        if block.language == "sh"
        for line in joined_lines(block.text)
        if line.startswith("make ")
    }
)

SAYING: Final = {
    # What is run, and what it prints.
    "make demo": "Predicted against measured",
    "make docs": "The site is built.",
    "make format": "All checks passed!",
    "make install": "Installed. Try: .venv/bin/taxel --help",
}

DRY: Final = {
    # What takes minutes or needs a package index, and what `make --dry-run` says that it would run. The
    # first is what runs this test; the others stand in no block.
    "make test": [
        ".venv/bin/ruff format --check .",
        ".venv/bin/ruff check .",
        ".venv/bin/mypy",
        ".venv/bin/lint-imports",
        ".venv/bin/python packaging/site",
        ".venv/bin/python -m pytest -n auto ",
    ],
    "make arm": [".venv/bin/python tests/arm/emulate.py"],
    "make coverage": [".venv/bin/python -m pytest --cov "],
    "make long": [".venv/bin/python -m pytest -n auto --maxprocesses 4 -m long"],
    "make matrix": ["python3 tests/matrix"],
}


def _git(*arguments: str, folder: Path = ROOT) -> str:
    return subprocess.run(
        ["git", *arguments], cwd=folder, capture_output=True, text=True, check=True
    ).stdout.strip()


@pytest.fixture(scope="module")
def checkout(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A clone as the files are now, whose `.venv` is that of the tests."""
    if not (ROOT / ".git").exists():
        pytest.skip("`make docs` needs a git checkout")
    if shutil.which("make") is None:
        pytest.skip("make is not here")
    clone = tmp_path_factory.mktemp("make") / "clone"
    _git("clone", "-q", "--no-tags", str(ROOT), str(clone))
    for name in _git("ls-files", "--cached", "--others", "--exclude-standard").splitlines():
        (clone / name).parent.mkdir(parents=True, exist_ok=True)
        if (ROOT / name).is_file():
            shutil.copy(ROOT / name, clone / name)
        else:
            (clone / name).unlink(missing_ok=True)
    environment = clone / ".venv"
    environment.mkdir()
    for name in ("bin", "lib", "pyvenv.cfg"):
        (environment / name).symlink_to(Path(sys.prefix) / name)
    # Newer than what they are made from: nothing is installed.
    for name in (".server", ".all", ".ros2", ".typescript"):
        (environment / name).touch()
    return clone


def _make(checkout: Path, line: str, *options: str) -> str:
    # Those of the `make test` that runs this test are not for this one.
    set_by_make = ("MAKE", "MFLAGS")
    variables = {name: value for name, value in os.environ.items() if not name.startswith(set_by_make)}
    done = subprocess.run(
        [*line.split(), *options],
        cwd=checkout,
        env=variables,
        capture_output=True,
        text=True,
        timeout=240,
        check=False,
    )
    assert done.returncode == 0, f"{line}: {done.stderr}\n{done.stdout}"
    assert "Installing" not in done.stdout
    return done.stdout


def test_every_line_is_run() -> None:
    assert sorted([*SAYING, "make test"]) == LINES


@pytest.mark.parametrize("line", SAYING)
def test_a_line_runs(checkout: Path, line: str) -> None:
    """And it leaves the files of the checkout as they are."""
    before = _git("status", "--porcelain", folder=checkout)
    assert SAYING[line] in _make(checkout, line)
    assert _git("status", "--porcelain", folder=checkout) == before


@pytest.mark.parametrize("line", DRY)
def test_a_long_line_would_run_what_it_says(checkout: Path, line: str) -> None:
    would_run = _make(checkout, line, "--dry-run")
    assert [command for command in DRY[line] if command not in would_run] == []
    named = re.findall(r"\b(?:tests|packaging)/\S+", would_run)
    assert [path for path in named if not (checkout / path).exists()] == []
