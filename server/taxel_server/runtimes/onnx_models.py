"""Evaluates ONNX models with ONNX Runtime."""

from pathlib import Path
from typing import Any, Final

import numpy as np
import onnxruntime
from numpy.typing import NDArray

from taxel.channels import CHANNELS
from taxel.errors import ArtifactError
from taxel.manifest import INPUT_NAME, OUTPUT_NAME, SPREAD_NAME, Normalisation
from taxel_server.runtimes.evaluator_info import EvaluatorInfo
from taxel_server.runtimes.options import DEFAULTS

_OUTPUTS: Final = ([OUTPUT_NAME], [OUTPUT_NAME, SPREAD_NAME])


class OnnxRuntime:
    """One ONNX model that takes raw windows and gives counts. Thread-safe; releases the GIL.

    Threads do not spin: beside a simulator's loop, a library that spins on every core takes the loop's
    time. With one thread, the caller's own thread computes.

    Args:
        normalisation: has to be folded into the model.
        threads: how many one evaluation may use.
        providers: ONNX Runtime's execution providers, best first.

    Attributes:
        features: values in one window.

    Raises:
        ArtifactError: the file is not such a model, or a provider is not available.
    """

    def __init__(
        self,
        model_path: Path,
        normalisation: Normalisation,
        threads: int = 1,
        providers: tuple[str, ...] = DEFAULTS.providers,
    ) -> None:
        if not normalisation.folded:
            raise ArtifactError(f"{model_path}: expected an ONNX model with its normalisation folded in")
        missing = [name for name in providers if name not in onnxruntime.get_available_providers()]
        if missing:
            known = ", ".join(onnxruntime.get_available_providers())
            raise ArtifactError(f"ONNX Runtime has no {', '.join(missing)} here; it has: {known}")
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = threads
        options.inter_op_num_threads = 1
        options.execution_mode = onnxruntime.ExecutionMode.ORT_SEQUENTIAL
        options.add_session_config_entry("session.intra_op.allow_spinning", "0")
        options.log_severity_level = 3
        try:
            self._session = onnxruntime.InferenceSession(model_path, options, providers=list(providers))
        except Exception as error:  # ONNX Runtime raises classes of its own for each kind of damage
            reason = str(error).strip().splitlines()[0]
            raise ArtifactError(f"{model_path}: ONNX Runtime cannot load it: {reason}") from None
        self.features = self._checked_shapes(model_path)
        self._given = (model_path, normalisation, threads, providers)

    def __reduce__(self) -> tuple[Any, ...]:
        # A session cannot be pickled: it is opened again.
        return OnnxRuntime, self._given

    def _checked_shapes(self, model_path: Path) -> int:
        inputs, outputs = self._session.get_inputs(), self._session.get_outputs()
        input_names, output_names = ([node.name for node in nodes] for nodes in (inputs, outputs))
        if input_names != [INPUT_NAME] or output_names not in _OUTPUTS:
            found = f"{input_names} to {output_names}"
            raise ArtifactError(f"{model_path}: {found}: expected {INPUT_NAME} to {OUTPUT_NAME}")
        shape = inputs[0].shape
        if (
            len(shape) != 2
            or not isinstance(shape[1], int)
            or any(output.shape[1:] != [len(CHANNELS)] for output in outputs)
        ):
            shapes = f"{shape} to {outputs[0].shape}"
            raise ArtifactError(f"{model_path}: {shapes}: expected (n, f) to (n, {len(CHANNELS)})")
        self._outputs = output_names
        return shape[1]

    def evaluate(self, windows: NDArray[np.float32]) -> NDArray[np.float32]:
        """Counts of windows (n, f) float32, C-contiguous, finite, n above 0.

        Returns:
            (n, 21) float32, or (n, 42) with the spread of each channel behind the channels.
        """
        outputs: list[NDArray[np.float32]] = self._session.run(self._outputs, {INPUT_NAME: windows})
        return outputs[0] if len(outputs) == 1 else np.hstack(outputs)

    def evaluator(self, rows: int) -> EvaluatorInfo:
        """ONNX Runtime with its first provider, for any number of windows."""
        del rows
        return EvaluatorInfo(f"onnxruntime ({self._session.get_providers()[0]})", "")
