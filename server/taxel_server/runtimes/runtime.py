"""The interface of runtimes, and the choice of a runtime for an artifact."""

from importlib import import_module
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from taxel.artifacts import Artifact
from taxel.errors import ArtifactError, MissingDependency
from taxel.manifest import Platform
from taxel_server.runtimes.corrected import CorrectedRuntime
from taxel_server.runtimes.evaluator_info import EvaluatorInfo
from taxel_server.runtimes.options import DEFAULTS, RuntimeOptions


class Runtime(Protocol):
    """Evaluates one model file. Thread-safe; releases the GIL while it computes.

    It can be pickled in one process and read in another one on the same machine.
    """

    @property
    def features(self) -> int:
        """Values in one window."""

    def evaluate(self, windows: NDArray[np.float32]) -> NDArray[np.float32]:
        """Counts of windows (n, f) float32, C-contiguous, finite, n above 0.

        Returns:
            (n, 21) float32, or (n, 42) with the spread of each channel behind the channels.
        """

    def evaluator(self, rows: int) -> EvaluatorInfo:
        """Which evaluator computes a call of so many windows, and with which instructions."""


_MODULES: Final[dict[Platform, str]] = {
    "xgboost_json": "taxel_server.runtimes.trees",
    "onnxruntime_onnx": "taxel_server.runtimes.networks",
}
"""What has `open_artifact` for each platform; it and its libraries are imported only when needed."""


def check_platform(platform: Platform) -> None:
    """Import what evaluates a platform's artifacts; the first time takes about a second.

    Raises:
        ArtifactError: there is no runtime for it, or one whose libraries fail when they are imported.
        MissingDependency: the runtime's library is not installed.
    """
    if platform not in _MODULES:
        raise ArtifactError(f"no runtime for {platform}; there is: {', '.join(_MODULES)}")
    try:
        import_module(_MODULES[platform])
    except ModuleNotFoundError as error:
        raise _missing(platform, error) from None
    except Exception as error:  # a library that does not fit this Python or its other libraries
        raise ArtifactError(f"the runtime for {platform} cannot be imported: {error!r}") from error


def open_runtime(artifact: Artifact, options: RuntimeOptions = DEFAULTS) -> Runtime:
    """The runtime of a checked artifact, with the effects that its manifest adds.

    Raises:
        ArtifactError: there is no runtime for its platform, or the model file contradicts its manifest.
        MissingDependency: the runtime's library is not installed.
    """
    manifest = artifact.manifest
    check_platform(manifest.platform)
    try:
        runtime: Runtime = import_module(_MODULES[manifest.platform]).open_artifact(artifact, options)
    except ModuleNotFoundError as error:  # of a library that is imported only when it is needed
        raise _missing(manifest.platform, error) from None
    expected = manifest.window.model_columns
    if runtime.features != expected:
        raise ArtifactError(
            f"{artifact.model_path} takes {runtime.features} features, but its manifest names {expected}"
        )
    return CorrectedRuntime(runtime.evaluate, runtime.evaluator, manifest) if manifest.effects else runtime


def _missing(platform: Platform, error: ModuleNotFoundError) -> MissingDependency:
    package = str(error.name).partition(".")[0]
    return MissingDependency(f"platform {platform}", package, "server")
