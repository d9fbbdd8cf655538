"""Which of the supported Pythons this machine has."""

import json
import os
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

SUPPORTED = ("3.11", "3.12", "3.13", "3.14")

_ASK = """
import ensurepip, json, sys, venv
print(json.dumps(["%d.%d" % sys.version_info[:2], "%d.%d.%d" % sys.version_info[:3]]))
"""


@dataclass(frozen=True)
class Python:
    """One interpreter that can make virtual environments.

    Attributes:
        minor: such as `3.12`.
        version: such as `3.12.1`.
    """

    minor: str
    version: str
    path: Path


def find(wanted: tuple[str, ...] = SUPPORTED) -> dict[str, Python]:
    """The first usable interpreter of each wanted minor version, by minor version.

    Those of pyenv come before those on `PATH`, the newest patch release first.
    """
    found: dict[str, Python] = {}
    for minor in wanted:
        for path in _candidates(minor):
            python = _asked(path)
            if python is not None and python.minor == minor:
                found[minor] = python
                break
    return found


def _candidates(minor: str) -> list[Path]:
    root = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv")) / "versions"
    patches = [path for path in root.glob(f"{minor}.*") if path.name.removeprefix(f"{minor}.").isdigit()]
    patches.sort(key=lambda path: int(path.name.rpartition(".")[2]), reverse=True)
    on_path = [shutil.which(name) for name in (f"python{minor}", "python3", "python")]
    return [path / "bin" / "python" for path in patches] + [Path(name) for name in on_path if name]


def _asked(path: Path) -> Python | None:
    """What an interpreter says of itself; None where it does not run or cannot make environments."""
    try:
        done = subprocess.run([path, "-I", "-c", _ASK], capture_output=True, text=True, timeout=60)
    except OSError:
        return None
    return Python(*json.loads(done.stdout), path=path) if done.returncode == 0 else None
