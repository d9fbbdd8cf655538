"""Predictors evaluated in this process, by whichever installed package provides an engine.

The engine lives in `taxel_server`, above this package; it makes itself known through an entry
point, so that nothing here imports upwards and a client installs without it.
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
        ArtifactError: it is no folder.
        MissingDependency: the engine is not installed.
    """
    for entry in entry_points(group=ENGINES):
        try:
            opener = cast("Callable[[Path], PredictorSource]", entry.load())
        except ModuleNotFoundError as error:
            raise MissingDependency("prediction in this process", str(error.name), "server") from None
        return opener(Path(repository))
    raise MissingDependency("prediction in this process", "taxel_server", "server")
