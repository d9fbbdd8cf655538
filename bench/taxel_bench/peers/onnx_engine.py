"""ONNX Runtime as a peer: a plain session, as its documentation shows it, with one thread."""

import numpy as np
import onnx
import onnxruntime

from taxel.manifest import OUTPUT_NAME, Manifest
from taxel_bench.engines import SAME_ANSWERS, THREADS, Engine


def onnx_engine(
    name: str, how: str, graph: onnx.ModelProto, manifest: Manifest, tolerance: float = SAME_ANSWERS
) -> Engine:
    """An engine of a graph that takes raw windows and gives counts."""
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = THREADS
    options.inter_op_num_threads = THREADS
    options.log_severity_level = 3
    session = onnxruntime.InferenceSession(
        graph.SerializeToString(), options, providers=["CPUExecutionProvider"]
    )
    columns = manifest.window.model_columns
    (given,) = (each.name for each in session.get_inputs())
    return Engine(
        name,
        f"{how}, ONNX Runtime {onnxruntime.__version__}",
        lambda windows: {given: np.ascontiguousarray(windows[:, :columns])},
        lambda feed: session.run([OUTPUT_NAME], feed),
        lambda outputs: np.asarray(outputs[0]),
        None,
        tolerance,
    )
