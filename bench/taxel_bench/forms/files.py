"""The model files of forests by name, written where there is none."""

import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Final, get_args

from taxel.artifacts import folder_of, read
from taxel.errors import SettingsError
from taxel_bench.forests import TreeShape, tree_shape, write_forest
from taxel_models.shipped import shipped_repository

_COMBINATION: Final = 1
_SHAPES: Final = {trees: tree_shape(trees, _COMBINATION) for trees in get_args(TreeShape)}


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
                files[name] = read(folder_of(shipped_repository(), "xgb")).model_path
            elif name in _SHAPES:
                files[name] = Path(folder) / f"{name}.json"
                write_forest(files[name], _SHAPES[name], seed)
            else:
                raise SettingsError(f"--forest {name}: expected some of {', '.join(_SHAPES)}, shipped")
        for model in models:
            files[str(model)] = read(model).model_path if model.is_dir() else model
        yield files
