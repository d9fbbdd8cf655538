"""Peers for networks: ONNX Runtime in float32 and twice in 8 bits, torch compiled, OpenVINO, NumPy."""

import copy
import logging
import math
import tempfile
from pathlib import Path
from typing import Any, Final

import numpy as np
import onnx
import torch
from numpy.typing import NDArray
from torch import Tensor

from taxel.channels import CHANNELS
from taxel.errors import SettingsError, Unavailable
from taxel_bench.engines import SAME_ANSWERS, THREADS, Engine
from taxel_bench.operations.of_network import count_network_operations
from taxel_bench.peers.numpy_graph import NumpyGraph
from taxel_bench.peers.onnx_engine import onnx_engine
from taxel_bench.peers.peer import GraphModel, Peer
from taxel_bench.published_way.eager import network_scaling
from taxel_exporters.onnx_int8 import with_int8_weights


def _float32(model: GraphModel) -> Engine:
    how = "InferenceSession.run, float32"
    return onnx_engine("onnxruntime", how, model.graph, model.artifact.manifest)


def _int8_weights(model: GraphModel) -> Engine:
    try:
        graph = with_int8_weights(model.graph)
    except SettingsError as error:
        raise Unavailable(str(error)) from None
    how = "weights of 8 bits with a scale for each 32 (taxel export --weights int8)"
    return onnx_engine("onnxruntime-int8", how, graph, model.artifact.manifest, math.inf)


def _int8_dynamic(model: GraphModel) -> Engine:
    from onnxruntime.quantization import QuantType, quantize_dynamic

    with tempfile.TemporaryDirectory(prefix="taxel-bench-") as folder:
        path = Path(folder) / "int8.onnx"
        # Its advice to prepare the file first is for convolutions.
        logging.disable(logging.WARNING)
        try:
            quantize_dynamic(model.artifact.model_path, path, weight_type=QuantType.QInt8)
        finally:
            logging.disable(logging.NOTSET)
        graph = onnx.load(path)
    how = "quantize_dynamic: weights and activations of 8 bits"
    return onnx_engine("onnxruntime-int8-dynamic", how, graph, model.artifact.manifest, math.inf)


def _compiled_torch(model: GraphModel) -> Engine:
    if model.network is None:
        raise Unavailable("there is no torch network behind this artifact")
    torch.compiler.reset()
    # Weights of its own: the published way's would be in the caches after that has had its turn.
    network = copy.deepcopy(model.network.network).cpu().eval()
    compiled = torch.compile(network, dynamic=False)
    prepare, counts, columns = network_scaling(model.network, model.artifact.manifest)
    flops = count_network_operations(model.network.network, columns)

    def evaluate(scores: Tensor) -> Tensor:
        with torch.inference_mode():
            result: Tensor = compiled(scores)
            return result

    return Engine(
        "torch-compiled",
        f"torch.compile for each batch size, without gradients, torch {torch.__version__}",
        prepare,
        evaluate,
        counts,
        flops,
        SAME_ANSWERS if model.same_weights else None,
    )


def _openvino(model: GraphModel) -> Engine:
    import openvino

    core = openvino.Core()
    columns = model.artifact.manifest.window.model_columns
    options = {
        "INFERENCE_NUM_THREADS": THREADS,
        "NUM_STREAMS": 1,
        "PERFORMANCE_HINT": "LATENCY",
        # Else it computes in bfloat16 on processors that have it.
        "INFERENCE_PRECISION_HINT": "f32",
    }
    requests: dict[int, Any] = {}

    def prepare(windows: NDArray[np.float32]) -> tuple[Any, NDArray[np.float32]]:
        rows = len(windows)
        if rows not in requests:
            network = core.read_model(model.artifact.model_path)
            network.reshape([rows, columns])
            requests[rows] = core.compile_model(network, "CPU", options).create_infer_request()
        return requests[rows], np.ascontiguousarray(windows[:, :columns])

    def evaluate(task: tuple[Any, NDArray[np.float32]]) -> Any:
        request, windows = task
        return request.infer({0: windows}, share_inputs=True, share_outputs=True)

    return Engine(
        "openvino",
        f"compiled for each batch size, float32, OpenVINO {openvino.__version__.split('-')[0]}",
        prepare,
        evaluate,
        # The request writes the next answer into the same memory.
        lambda outputs: np.array(outputs[0]),
        None,
        SAME_ANSWERS,
    )


def _numpy(model: GraphModel) -> Engine:
    graph = NumpyGraph(model.graph)
    columns = model.artifact.manifest.window.model_columns
    return Engine(
        "numpy",
        f"products of matrices, NumPy {np.__version__}",
        lambda windows: np.ascontiguousarray(windows[:, :columns]),
        graph.evaluate,
        lambda outputs: outputs[:, : len(CHANNELS)],
        None,
        SAME_ANSWERS,
    )


GRAPH_PEERS: Final = (
    Peer[GraphModel]("onnxruntime", _float32),
    Peer[GraphModel]("onnxruntime-int8", _int8_weights),
    Peer[GraphModel]("onnxruntime-int8-dynamic", _int8_dynamic),
    Peer[GraphModel]("torch-compiled", _compiled_torch),
    Peer[GraphModel]("openvino", _openvino, ("openvino==2026.4.1",), "openvino"),
    Peer[GraphModel]("numpy", _numpy),
)
