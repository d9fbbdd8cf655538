"""Each peer's own virtual environment, made on request in a cache folder and kept there.

An environment appears whole or not at all: one whose making was interrupted is made again.
"""

import json
import os
import subprocess
import venv
from collections.abc import Sequence
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Final

from taxel.atomic import whole_folder
from taxel.errors import Unavailable

_LIST: Final = "requirements.json"
"""In each environment: what was asked for. Another list means that it is made anew."""


def cache_folder() -> Path:
    """Where environments are kept: `taxel/peers` in the user's cache folder.

    Those of libraries are in `engines` there, those of servers in `servers`.
    """
    named = os.environ.get("XDG_CACHE_HOME")
    return (Path(named) if named else Path.home() / ".cache") / "taxel" / "peers"


def environment(name: str, requirements: Sequence[str], *, install: bool) -> Path:
    """The interpreter of an environment that holds exactly these requirements.

    Args:
        name: its folder below the cache folder.
        install: whether it is made if there is none.

    Raises:
        Unavailable: there is none, or they could not be installed; then the text is pip's.
    """
    folder = cache_folder() / name
    try:
        found = json.loads((folder / _LIST).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        found = None
    if found == list(requirements):
        return interpreter_of(folder)
    if not install:
        state = "not installed" if found is None else "installed in other versions"
        raise Unavailable(f"{state}: pass --install to install {', '.join(requirements)} in {folder}")
    with whole_folder(folder, replacing=_LIST) as making:
        _fill(making, requirements)
    return interpreter_of(folder)


def own_versions(*packages: str) -> list[str]:
    """Requirements that ask for the versions that Taxel itself runs on, of the packages that it has."""
    found = []
    for name in packages:
        with suppress(PackageNotFoundError):
            found.append(f"{name}=={version(name)}")
    return found


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
