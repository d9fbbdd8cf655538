"""What every peer serves: the network, evaluated with the settings that Taxel's runtime uses."""

import argparse

import numpy as np
import onnxruntime


class Network:
    """An ONNX model that turns windows into counts, on one thread that does not spin."""

    def __init__(self, path: str) -> None:
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = 1
        options.inter_op_num_threads = 1
        options.execution_mode = onnxruntime.ExecutionMode.ORT_SEQUENTIAL
        options.add_session_config_entry("session.intra_op.allow_spinning", "0")
        self._session = onnxruntime.InferenceSession(path, options, providers=["CPUExecutionProvider"])
        window = self._session.get_inputs()[0]
        self._input = window.name
        self._output = self._session.get_outputs()[0].name
        self._features = window.shape[1]

    def predict(self, body: bytes) -> bytes:
        """Counts (n, 21) of windows (n, f), both little-endian float32, rows one after the other."""
        windows = np.frombuffer(body, "<f4").reshape(-1, self._features)
        counts: bytes = self._session.run([self._output], {self._input: windows})[0].tobytes()
        return counts


def server_arguments() -> argparse.Namespace:
    """What a server is told: `model`, the path of the ONNX file, and where to listen."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--model", required=True)
    parser.add_argument("--port", required=True, type=int)
    parser.add_argument("--address", required=True)
    return parser.parse_args()
