"""Predictors that are evaluated in this process, by an installed package with an engine.

The engine is in `taxel_server`, and the shipped models are beside `taxel_models`. Both are above this
package. They are found through entry points, so this package does not import them and a client can be
installed without them.
"""

from collections.abc import Callable
from importlib.metadata import entry_points
from os import PathLike
from pathlib import Path
from typing import Final, cast

from taxel.errors import ArtifactError, InvalidArgument, MissingDependency
from taxel.predictor import PredictorSource

ENGINES: Final = "taxel.engines"
REPOSITORIES: Final = "taxel.repositories"


def load(repository: str | Path | None = None) -> PredictorSource:
    """Open a repository of artifacts for prediction in this process.

    Args:
        repository: its folder; if none, the models that come with Taxel.

    Raises:
        ArtifactError: the path is not a folder.
        InvalidArgument: that is no path.
        MissingDependency: the engine is not installed.
    """
    if repository is None:
        repository = shipped_repository()
    elif not isinstance(repository, (str, PathLike)):
        raise InvalidArgument(f"repository is {repository!r}: expected a folder's path, or None")
    for entry in entry_points(group=ENGINES):
        try:
            opener = cast("Callable[[Path], PredictorSource]", entry.load())
        except ModuleNotFoundError as error:
            raise MissingDependency("prediction in this process", str(error.name), "server") from None
        return opener(Path(repository))
    raise MissingDependency("prediction in this process", "taxel_server", "server")


def shipped_repository() -> Path:
    """The folder of the models that come with Taxel.

    Raises:
        ArtifactError: this installation has none.
    """
    entry = next(iter(entry_points(group=REPOSITORIES)), None)
    if entry is None:
        raise ArtifactError(
            "this installation has no shipped models: expected a repository's folder, or a new installation"
        )
    return cast("Callable[[], Path]", entry.load())()
