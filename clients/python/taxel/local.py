"""Predictors that are evaluated in this process, by an installed package with an engine.

The engine is in `taxel_server`, above this package. It is found through an entry point, so this package
does not import it and a client can be installed without it.
"""

from collections.abc import Callable
from importlib.metadata import entry_points
from pathlib import Path
from typing import Final, cast

from taxel.errors import MissingDependency
from taxel.predictor import PredictorSource

ENGINES: Final = "taxel.engines"


def load(repository: str | Path) -> PredictorSource:
    """Open a repository of artifacts for prediction in this process.

    Raises:
        ArtifactError: the path is not a folder.
        MissingDependency: the engine is not installed.
    """
    for entry in entry_points(group=ENGINES):
        try:
            opener = cast("Callable[[Path], PredictorSource]", entry.load())
        except ModuleNotFoundError as error:
            raise MissingDependency("prediction in this process", str(error.name), "server") from None
        return opener(Path(repository))
    raise MissingDependency("prediction in this process", "taxel_server", "server")
