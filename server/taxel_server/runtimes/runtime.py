"""What a runtime is, and which one evaluates an artifact."""

from pathlib import Path
from pkgutil import resolve_name
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from taxel.artifacts import Artifact
from taxel.errors import ArtifactError, MissingDependency
from taxel.manifest import Normalisation, Platform


class Runtime(Protocol):
    """Evaluates one model file. Thread-safe; lets go of the GIL while it computes."""

    @property
    def features(self) -> int:
        """Values in one window."""

    def evaluate(self, windows: NDArray[np.float32]) -> NDArray[np.float32]:
        """Counts of windows (n, f) float32, C-contiguous, finite, n above 0.

        Returns:
            (n, 21) float32, or (n, 42) with the spread of each channel behind the channels.
        """


class RuntimeFactory(Protocol):
    """How every runtime is made: from a model file and the manifest's normalisation."""

    def __call__(self, model_path: Path, normalisation: Normalisation, threads: int = 1) -> Runtime:
        """Raises `ArtifactError` where the model file is none of its platform's."""


_FACTORIES: Final[dict[Platform, str]] = {
    "xgboost_json": "taxel_server.runtimes.trees:TreesRuntime",
    "onnxruntime_onnx": "taxel_server.runtimes.onnx_models:OnnxRuntime",
}
"""Where each platform's factory lies: imported on first use, as each needs its own libraries."""


def open_runtime(artifact: Artifact, threads: int = 1) -> Runtime:
    """The runtime of a checked artifact.

    Raises:
        ArtifactError: no runtime for its platform, or a model file at odds with its manifest.
        MissingDependency: the runtime's library is not installed.
    """
    manifest = artifact.manifest
    if manifest.platform not in _FACTORIES:
        known = ", ".join(_FACTORIES)
        raise ArtifactError(f"{artifact.model_path}: no runtime for {manifest.platform}; there is: {known}")
    factory: RuntimeFactory
    try:
        factory = resolve_name(_FACTORIES[manifest.platform])
    except ModuleNotFoundError as error:
        raise MissingDependency(f"platform {manifest.platform}", str(error.name), "server") from None
    runtime = factory(artifact.model_path, manifest.normalisation, threads)
    expected = len(manifest.window.features)
    if runtime.features != expected:
        raise ArtifactError(
            f"{artifact.model_path} takes {runtime.features} features, but its manifest names {expected}"
        )
    return runtime
