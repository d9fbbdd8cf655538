"""Predictors that are evaluated in this process, without a server or a transport."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from taxel.channels import CHANNELS
from taxel.errors import Unavailable
from taxel.predictor import DEFAULT_MODEL, ModelInfo, Predictor, PredictorSource
from taxel_server.engine import Engine, LoadedModel
from taxel_server.runtimes import DEFAULTS, RuntimeOptions


class LocalSource(PredictorSource):
    """A repository's models, each loaded when its predictor is first asked for.

    Args:
        repository: folder of `<name>/<version>/` artifacts.
        options: options of the evaluation.

    Raises:
        ArtifactError: the repository is no folder.
    """

    def __init__(self, repository: Path, options: RuntimeOptions = DEFAULTS) -> None:
        self._engine = Engine(repository, options)
        self.closed = False

    @override
    def models(self) -> list[ModelInfo]:
        self.check_open()
        return self._engine.models()

    @override
    def predictor(self, name: str = DEFAULT_MODEL, version: str | None = None) -> "LocalPredictor":
        self.check_open()
        return LocalPredictor(self, self._engine.model(name, version))

    @override
    def close(self) -> None:
        self.closed = True

    def check_open(self) -> None:
        """Raise if it was closed.

        Raises:
            Unavailable: it was closed.
        """
        if self.closed:
            raise Unavailable("this repository was closed")


class LocalPredictor(Predictor):
    """One model of a repository; made by `LocalSource.predictor`."""

    def __init__(self, source: LocalSource, model: LoadedModel) -> None:
        super().__init__(model.manifest)
        self._source = source
        self._evaluate = model.runtime.evaluate
        self._evaluate_base = model.evaluate_base
        self._only_channels = not model.manifest.gives_spread

    @override
    def predict(self, windows: NDArray[Any], *, timeout: float | None = None) -> NDArray[np.float32]:
        if self._source.closed:
            self._source.check_open()
        outputs = self._evaluate(self.checked(windows))
        return outputs if self._only_channels else outputs[:, : len(CHANNELS)]

    @override
    def predict_base(self, windows: NDArray[Any], *, timeout: float | None = None) -> NDArray[np.float32]:
        self._source.check_open()
        return self._evaluate_base(self.checked(windows))[:, : len(CHANNELS)]

    @override
    def predict_with_spread(
        self, windows: NDArray[Any], *, timeout: float | None = None
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        self._source.check_open()
        self.check_gives_spread()
        outputs = self._evaluate(self.checked(windows))
        return outputs[:, : len(CHANNELS)], outputs[:, len(CHANNELS) :]


def open_repository(path: Path) -> LocalSource:
    """Open a repository; `taxel.load` finds this function through the entry point `taxel.engines`.

    Raises:
        ArtifactError: the path is not a folder.
    """
    return LocalSource(path)
