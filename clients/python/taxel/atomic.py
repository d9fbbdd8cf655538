"""Files and folders that appear whole or not at all: written beside their place, then renamed."""

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from taxel.errors import SettingsError


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Yield a temporary path to write to; it takes the place of `path` if the block succeeds.

    Raises:
        SettingsError: the folder that it should lie in does not exist.
    """
    if not path.parent.is_dir():
        raise SettingsError(f"{path}: the folder {path.parent} does not exist")
    temporary = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        yield temporary
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


@contextmanager
def whole_folder(path: Path, *, overwrite: bool = False) -> Iterator[Path]:
    """Yield a temporary folder to fill; it takes the place of `path` if the block succeeds.

    Raises:
        SettingsError: `path` exists already, and is not to be overwritten.
    """
    check_free(path, overwrite=overwrite)
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = Path(tempfile.mkdtemp(prefix=f".{path.name}.", suffix=".part", dir=path.parent))
    try:
        temporary.chmod(0o755)
        yield temporary
        if path.exists():
            old = Path(tempfile.mkdtemp(prefix=f".{path.name}.", suffix=".old", dir=path.parent))
            path.replace(old)
            temporary.replace(path)
            shutil.rmtree(old)
        else:
            temporary.replace(path)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def check_free(path: Path, *, overwrite: bool = False) -> None:
    """Refuse, before any work is done, a place that may not be written.

    Raises:
        SettingsError: `path` exists already, and is not to be overwritten.
    """
    if path.exists() and not overwrite and not (path.is_dir() and not any(path.iterdir())):
        raise SettingsError(f"{path} exists already: choose another place, or pass --overwrite")
