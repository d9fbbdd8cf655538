"""The wheel, clean environments to install it into, and commands that run there."""

import json
import os
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from pythons import Python

TIMEOUT_S = 1800

# Their releases are source archives of plain Python; there is nothing to compile.
PURE = ("smac", "pynisher")


class Failed(Exception):
    """A step did not do what it should; the text says what came instead."""


def build_wheel(python: Python, root: Path, folder: Path) -> Path:
    """Build the project's wheel into a folder, with pip and the build backend that it fetches."""
    with environment(python) as builder:
        builder.python(*("-m", "pip", "wheel", "-q", "--no-deps", "-w", folder, root))
    (wheel,) = folder.glob("*.whl")
    return wheel


@contextmanager
def environment(python: Python, wheel: Path | None = None) -> Iterator["Environment"]:
    """A new virtual environment with pip alone; deleted with its folder of work afterwards."""
    with TemporaryDirectory(prefix="taxel-matrix-") as name:
        folder = Path(name).resolve()
        subprocess.run([python.path, "-I", "-m", "venv", folder / "environment"], check=True)
        (folder / "work").mkdir()
        yield Environment(folder / "environment", folder / "work", python, wheel)


class Environment:
    """A virtual environment and an empty folder to work in, both outside the checkout.

    Args:
        folder: of the virtual environment.
        work: where its commands run.
        interpreter: that it was made with.
        wheel: of the project, to install in another one beside it.
    """

    def __init__(self, folder: Path, work: Path, interpreter: Python, wheel: Path | None) -> None:
        self.folder = folder
        self.work = work
        self.interpreter = interpreter
        self.wheel = wheel

    def install(self, *requirements: str | Path, constraints: Path | None = None) -> None:
        """Install packages from wheels alone; `constraints` is a file of versions to take."""
        limits = ("-c", constraints) if constraints else ()
        sources = [option for name in PURE for option in ("--no-binary", name)]
        self.python(
            *("-m", "pip", "install", "-q", "--only-binary", ":all:", *sources), *limits, *requirements
        )

    def installed(self) -> dict[str, str]:
        """The version of each installed package."""
        listed = json.loads(self.python("-m", "pip", "list", "--format", "json").stdout)
        return {package["name"]: package["version"] for package in listed}

    def python(self, *arguments: str | Path, check: bool = True) -> subprocess.CompletedProcess[str]:
        """Run this environment's Python."""
        return self.run("python", *arguments, check=check)

    def run(
        self, program: str, *arguments: str | Path, check: bool = True
    ) -> subprocess.CompletedProcess[str]:
        """Run a program of this environment, without what the caller's environment sets for Python.

        Raises:
            Failed: `check` is true and it ends with another status than 0.
        """
        command = self._command(program, arguments)
        try:
            done = subprocess.run(
                command, capture_output=True, text=True, cwd=self.work, env=_clean(), timeout=TIMEOUT_S
            )
        except subprocess.TimeoutExpired:
            raise Failed(f"{_shown(program, arguments)}: still running after {TIMEOUT_S} s") from None
        if check and done.returncode != 0:
            said = f"{done.stdout.strip()}\n{done.stderr.strip()}".strip()[-4000:]
            raise Failed(f"{_shown(program, arguments)}: exit {done.returncode}\n{said}")
        return done

    def started(
        self, program: str, *arguments: str | Path, stderr: int | None = None
    ) -> subprocess.Popen[str]:
        """The same, but it runs on; what it prints is for whoever reads `stdout`."""
        return subprocess.Popen(
            self._command(program, arguments),
            cwd=self.work,
            env=_clean(),
            text=True,
            stdout=subprocess.PIPE,
            stderr=stderr,
        )

    def _command(self, program: str, arguments: tuple[str | Path, ...]) -> list[str]:
        return [str(self.folder / "bin" / program), *map(str, arguments)]


def _clean() -> dict[str, str]:
    """The caller's environment without what it sets for Python and Taxel."""
    clean = {
        name: value
        for name, value in os.environ.items()
        if not name.startswith(("PYTHON", "TAXEL", "VIRTUAL_ENV"))
    }
    # Wide, so that what is looked for in an error is not broken over lines.
    return clean | {"COLUMNS": "200", "PIP_DISABLE_PIP_VERSION_CHECK": "1"}


def _shown(program: str, arguments: tuple[str | Path, ...]) -> str:
    return " ".join([program, *map(str, arguments)])[:200]
