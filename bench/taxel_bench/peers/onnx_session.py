"""A plain session of ONNX Runtime, as its documentation shows it, with one thread."""

from pathlib import Path
from typing import Any

import onnxruntime

from taxel_bench.engines import THREADS


def onnx_session(model: bytes | Path) -> tuple[Any, str]:
    """A session of a model, and ONNX Runtime's version."""
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = THREADS
    options.inter_op_num_threads = THREADS
    options.log_severity_level = 3
    session = onnxruntime.InferenceSession(model, options, providers=["CPUExecutionProvider"])
    return session, onnxruntime.__version__
