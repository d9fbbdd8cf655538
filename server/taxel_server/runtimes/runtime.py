"""The interface of runtimes, and the choice of a runtime for an artifact."""

from collections.abc import Callable
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


Factory = Callable[[Artifact, RuntimeOptions], Runtime]


def _trees(artifact: Artifact, options: RuntimeOptions) -> Runtime:
    from taxel_server.runtimes.trees import TreesRuntime

    return TreesRuntime(artifact.model_path, artifact.manifest.normalisation, options.threads)


def _onnx(artifact: Artifact, options: RuntimeOptions) -> Runtime:
    from taxel_server.runtimes.graph_checks import check_graph
    from taxel_server.runtimes.networks import faster_runtime
    from taxel_server.runtimes.onnx_models import OnnxRuntime

    path, normalisation = artifact.model_path, artifact.manifest.normalisation
    check_graph(path)
    runtime = OnnxRuntime(path, normalisation, options.threads, options.providers)
    if runtime.features != len(normalisation.input_mean):
        return runtime  # which `open_runtime` refuses
    if options.providers != DEFAULTS.providers or not options.network_program:
        return runtime
    return faster_runtime(path, normalisation, runtime)


_FACTORIES: Final[dict[Platform, Factory]] = {"xgboost_json": _trees, "onnxruntime_onnx": _onnx}
"""Makes each platform's runtime; its libraries are imported only then."""


_MODULES: Final[dict[Platform, tuple[str, ...]]] = {
    "xgboost_json": ("taxel_server.runtimes.trees",),
    "onnxruntime_onnx": ("taxel_server.runtimes.onnx_models", "taxel_server.runtimes.networks"),
}
"""What each factory imports."""


def check_platform(platform: Platform) -> None:
    """Import what evaluates a platform's artifacts; the first time takes about a second.

    Raises:
        ArtifactError: there is no runtime for it, or one whose libraries fail when they are imported.
        MissingDependency: the runtime's library is not installed.
    """
    if platform not in _FACTORIES:
        raise ArtifactError(f"no runtime for {platform}; there is: {', '.join(_FACTORIES)}")
    try:
        for name in _MODULES[platform]:
            import_module(name)
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
        runtime = _FACTORIES[manifest.platform](artifact, options)
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
