"""Each peer's own virtual environment, made on request in a cache folder and kept there.

An environment appears whole or not at all: one whose making was interrupted is made again.
"""

import json
import os
import subprocess
import venv
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from taxel.atomic import whole_folder
from taxel.errors import Unavailable

_LIST: Final = "requirements.json"
"""In each environment: what was asked for. Another list means that it is made anew."""


def cache_folder() -> Path:
    """Where environments are kept: `taxel/peers` in the user's cache folder."""
    named = os.environ.get("XDG_CACHE_HOME")
    return (Path(named) if named else Path.home() / ".cache") / "taxel" / "peers"


def find_environment(name: str, requirements: Sequence[str]) -> Path:
    """The interpreter of an environment that holds exactly these requirements.

    Raises:
        Unavailable: there is none.
    """
    folder = cache_folder() / name
    try:
        found = json.loads((folder / _LIST).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        found = None
    if found != list(requirements):
        state = "not installed" if found is None else "installed in other versions"
        raise Unavailable(f"{state}: pass --install to install {', '.join(requirements)} in {folder}")
    return interpreter_of(folder)


def install_environment(name: str, requirements: Sequence[str]) -> Path:
    """The interpreter of an environment that holds these requirements, made if there is none.

    Raises:
        Unavailable: they could not be installed; the text is pip's.
    """
    try:
        return find_environment(name, requirements)
    except Unavailable:
        with whole_folder(cache_folder() / name, replacing=_LIST) as folder:
            _fill(folder, requirements)
    return interpreter_of(cache_folder() / name)


def _fill(folder: Path, requirements: Sequence[str]) -> None:
    try:
        venv.EnvBuilder(with_pip=bool(requirements)).create(folder)
        if requirements:
            pip = [str(interpreter_of(folder)), "-m", "pip", "install", "--quiet", "--no-input"]
            subprocess.run([*pip, *requirements], check=True, capture_output=True, text=True)
    except subprocess.CalledProcessError as error:
        said = (error.stderr or error.stdout or "").strip().splitlines()
        raise Unavailable(f"cannot be installed: {said[-1] if said else error}") from None
    (folder / _LIST).write_text(json.dumps(list(requirements)), encoding="utf-8")


def interpreter_of(folder: Path) -> Path:
    """The interpreter of the environment in a folder."""
    return folder / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
