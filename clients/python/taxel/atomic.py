"""Files and folders that appear whole or not at all. They are written beside their place and then renamed.

One case is weaker. If a folder replaces another and the process is killed between two renames, the old
folder stays beside its place, as `.NAME.….old`.
"""

import json
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from taxel.errors import SettingsError


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Yield a temporary path to write to; it becomes `path` if the block succeeds.

    Raises:
        SettingsError: a file cannot be written at `path`.
    """
    check_file_place(path)
    # A link stays one: the file that it leads to is replaced.
    path = path.resolve() if path.is_symlink() else path
    temporary = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        yield temporary
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write a whole file in UTF-8.

    Raises:
        SettingsError: a file cannot be written at `path`.
    """
    with whole_file(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def write_json(path: Path, content: object) -> None:
    """Write a whole JSON file, indented.

    Raises:
        SettingsError: a file cannot be written at `path`.
        ValueError: a number is not finite.
    """
    write_text(path, json.dumps(content, indent=1, allow_nan=False) + "\n")


def check_file_place(path: Path, *, reads: Path | None = None) -> None:
    """Check before any work that a file can be written here.

    Args:
        reads: a file or folder that is read, and must not be overwritten.

    Raises:
        SettingsError: its folder does not exist or takes no file, or it is a folder itself, a device, a
            pipe, or what is read.
    """
    if path.is_dir():
        raise SettingsError(f"{path} is a folder: expected the name of a file to write")
    if path.exists() and not path.is_file():
        raise SettingsError(f"{path} is a device or a pipe: expected the name of a file to write")
    folder = path.resolve().parent if path.is_symlink() else path.parent
    if not folder.is_dir():
        raise SettingsError(f"{path}: the folder {folder} does not exist")
    if reads is not None and path.exists() and reads.resolve() in (path.resolve(), *path.resolve().parents):
        raise SettingsError(f"{path} is what is read: expected another place to write to")
    _check_takes_files(path, folder)


def _check_takes_files(path: Path, folder: Path) -> None:
    try:
        tempfile.TemporaryDirectory(prefix=f".{path.name}.", dir=folder).cleanup()
    except OSError as error:
        raise SettingsError(f"{path}: nothing can be written in {folder}: {error.strerror}") from None


@contextmanager
def whole_folder(path: Path, *, replacing: str | None = None, overwrite: bool = True) -> Iterator[Path]:
    """Yield a temporary folder to fill; it becomes `path` if the block succeeds.

    Args:
        path: where the folder will be; missing parents are made.
        replacing: a folder that holds a file of this name may be replaced.
        overwrite: as in `check_folder_place`.

    Raises:
        SettingsError: something else is already at `path`.
    """
    path = path.resolve()
    check_folder_place(path, replacing=replacing, overwrite=overwrite)
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = Path(tempfile.mkdtemp(prefix=f".{path.name}.", suffix=".part", dir=path.parent))
    try:
        temporary.chmod(0o755)
        yield temporary
        _replace(path, temporary)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def _replace(path: Path, new: Path) -> None:
    if not path.exists():
        new.replace(path)
        return
    old = Path(tempfile.mkdtemp(prefix=f".{path.name}.", suffix=".old", dir=path.parent))
    path.replace(old)
    try:
        new.replace(path)
    except OSError:
        old.replace(path)
        raise
    shutil.rmtree(old)


def check_folder_place(path: Path, *, replacing: str | None = None, overwrite: bool = True) -> None:
    """Check before any work that a folder can be written here.

    Args:
        replacing: a folder that holds a file of this name may be replaced.
        overwrite: whether it may be, as the user says by `--overwrite`.

    Raises:
        SettingsError: something else is at `path`, a file is where one of its folders should be, or
            nothing can be written there.
    """
    path = path.absolute()
    above = next(parent for parent in path.parents if parent.exists())
    if above.is_file():
        raise SettingsError(f"{path}: {above} is a file: expected a folder")
    _check_takes_files(path, above)
    if not path.exists() or (path.is_dir() and not any(path.iterdir())):
        return
    if not path.is_dir():
        raise SettingsError(f"{path} is a file: expected the name of a folder to write")
    if replacing is None:
        raise SettingsError(f"{path} exists already: choose another place")
    if not overwrite:
        raise SettingsError(f"{path} exists already: choose another place, or pass --overwrite")
    if not (path / replacing).is_file():
        raise SettingsError(f"{path} holds no {replacing}: it is not ours to replace; choose another place")
