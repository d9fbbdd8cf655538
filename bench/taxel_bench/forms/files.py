"""The model files of forests by name, written where there is none."""

import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from taxel.artifacts import read
from taxel.errors import SettingsError
from taxel_bench.forests import SKEWED, paper_forest, write_forest
from taxel_models.shipped import shipped_repository

_COMBINATION: Final = 1
_SHAPES: Final = {"even": paper_forest(_COMBINATION), "skewed": SKEWED}


@contextmanager
def forest_files(names: Sequence[str], models: Sequence[Path], seed: int) -> Iterator[dict[str, Path]]:
    """The files by what they are called in results; those that were written are removed at the end.

    Args:
        names: `even`, `skewed` and `shipped`, or none of them.
        models: folders of artifacts, or model files.
        seed: of random forests.

    Raises:
        SettingsError: there is no such forest.
        ArtifactError: a folder is no artifact.
    """
    with tempfile.TemporaryDirectory() as folder:
        files = dict[str, Path]()
        for name in filter(None, names):
            if name == "shipped":
                files[name] = read(shipped_repository() / "xgb" / "1").model_path
            elif name in _SHAPES:
                files[name] = Path(folder) / f"{name}.json"
                write_forest(files[name], _SHAPES[name], seed)
            else:
                raise SettingsError(f"--forest {name}: expected some of {', '.join(_SHAPES)}, shipped")
        for model in models:
            files[str(model)] = read(model).model_path if model.is_dir() else model
        yield files
