"""Finished cells on disk, one file each, so that a killed study can continue."""

import logging
from pathlib import Path
from typing import Final

from pydantic import ValidationError

from taxel.artifacts import describe
from taxel.atomic import write_text
from taxel.errors import SettingsError
from taxel_models.study.cell import CellResult
from taxel_models.study.study_settings import Cell

_LOG: Final = logging.getLogger(__name__)


class Store:
    """The folder of a study.

    OUT/cells/NAME-KEY.json       a finished cell
    OUT/checkpoints/NAME-KEY.pt   the progress of an unfinished network

    Args:
        folder: an earlier study's folder, or a place for a new one.

    Raises:
        SettingsError: something else is there.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder.resolve()
        self._cells = self.folder / "cells"
        self._checkpoints = self.folder / "checkpoints"
        if self.folder.exists() and not self._cells.is_dir():
            if not self.folder.is_dir():
                raise SettingsError(f"{folder} is a file: expected the name of a folder to write")
            if any(self.folder.iterdir()):
                raise SettingsError(f"{folder} is no study's folder and not empty: choose another place")
        for place in (self._cells, self._checkpoints):
            place.mkdir(parents=True, exist_ok=True)

    def checkpoint(self, cell: Cell, key: str) -> Path:
        """Where a network keeps its progress."""
        return self._checkpoints / f"{_name(cell, key)}.pt"

    def read(self, cell: Cell, key: str) -> CellResult | None:
        """A finished cell; None if it is not finished, or its file is damaged."""
        path = self._path(cell, key)
        try:
            result = CellResult.model_validate_json(path.read_bytes())
        except FileNotFoundError:
            return None
        except ValidationError as error:
            _LOG.warning("%s is damaged and computed again: %s", path, describe(error))
            return None
        if result.key != key:
            _LOG.warning("%s holds another cell and is computed again", path)
            return None
        return result

    def write(self, cell: Cell, result: CellResult) -> None:
        """Keep a finished cell."""
        write_text(self._path(cell, result.key), result.model_dump_json(indent=1) + "\n")

    def _path(self, cell: Cell, key: str) -> Path:
        return self._cells / f"{_name(cell, key)}.json"


def _name(cell: Cell, key: str) -> str:
    return f"{cell.name}-{key[:12]}"
