"""Writes the transformer as ONNX node by node: raw windows in, counts out.

torch's exporter writes the whole network. Here only values that reach the output are computed, and
constants are computed at export, in float64:

- The head reads the class token alone, so the last block computes only that token. Its single
  query meets the tokens themselves instead of a key and a value of each: with k = t K + b, the
  score q·k is (q Kᵀ)·t plus q·b, which is the same for every token and drops out of the softmax;
  the weighted mean of values is that of the tokens, times V.
- The class token and the embedding's bias are part of the positions, the attention's scale of the
  queries, and the outputs' normalisation of the head.
"""

import math
from typing import Final

import numpy as np
import onnx
from numpy.typing import NDArray

from taxel.manifest import INPUT_NAME
from taxel_exporters.onnx_graph import Graph
from taxel_models.families.networks.network import NetworkModel
from taxel_models.families.networks.transformer import PATCH, TransformerHyperparameters
from taxel_models.training.trained import TrainedModel

Array = NDArray[np.float64]

_EPSILON: Final = 1e-5
"""torch's default in LayerNorm."""


def transformer_onnx(trained: TrainedModel) -> onnx.ModelProto:
    """The ONNX model of a trained transformer."""
    fitted = trained.fitted
    assert isinstance(fitted, NetworkModel)
    assert isinstance(fitted.hyperparameters, TransformerHyperparameters)
    statistics = trained.record.normalisation
    graph = Graph()
    window = INPUT_NAME
    if trained.served_extras:
        # Others in an ensemble take extras, behind the window.
        bounds = [graph.constant([value], np.int64) for value in (0, trained.spec.length, 1)]
        window = graph.node("Slice", window, *bounds)
    columns = graph.node("Sub", window, graph.constant(statistics.input_mean))
    columns = graph.node("Div", columns, graph.constant(statistics.input_std))
    encoder = _Encoder(graph, fitted, fitted.hyperparameters)
    first = encoder.first_token(columns)
    scale, mean = np.asarray(statistics.output_std), np.asarray(statistics.output_mean)
    weights, bias = encoder.linear("head")
    encoder.dense(first, weights * scale, bias * scale + mean)
    return graph.model(len(trained.layout.features))


class _Encoder:
    """Adds the network's parts to a graph.

    Tokens are kept as (n · length, width), which is what dense layers take, and become
    (n, length, ...) only where they attend to each other.
    """

    def __init__(self, graph: Graph, model: NetworkModel, chosen: TransformerHyperparameters) -> None:
        self.graph = graph
        self.layers, self.heads, self.width = chosen.layers, chosen.heads, chosen.embedding
        self.size = self.width // self.heads
        self.length = model.shape.spec.length // PATCH + 1
        self.values = {
            name: value.detach().cpu().numpy().astype(np.float64)
            for name, value in model.network.state_dict().items()
        }

    def first_token(self, columns: str) -> str:
        """The class token behind all blocks, normalised, (n, width), of columns (n, f)."""
        tokens = self.embedded(columns)
        for number in range(self.layers - 1):
            tokens = self.block(f"blocks.{number}", tokens)
        return self.normalised("normalise", self.last_block(f"blocks.{self.layers - 1}", tokens))

    def embedded(self, columns: str) -> str:
        """Tokens of columns: an empty patch in front makes room for the class token."""
        positions = self.values["positions"][0].copy()
        positions[0] += self.values["class_token"][0, 0]
        weights, bias = self.linear("embed")
        positions[1:] += bias
        room = self.graph.constant([0, PATCH, 0, 0], np.int64)
        patches = self.shaped(self.graph.node("Pad", columns, room), -1, self.length, PATCH)
        tokens = self.graph.node("MatMul", patches, self.graph.constant(weights))
        return self.shaped(self.graph.node("Add", tokens, self.graph.constant(positions)), -1, self.width)

    def block(self, name: str, tokens: str) -> str:
        """One block for every token."""
        weights, bias = self.queries_keys_values(name)
        together = self.dense(
            self.normalised(f"{name}.before_attention", tokens),
            np.concatenate(weights, axis=1),
            np.concatenate(bias),
        )
        heads = self.shaped(together, -1, self.length, 3 * self.heads, self.size)
        queries, keys, values = self.graph.split(heads, 3, axis=2)
        scores = self.graph.node(
            "MatMul",
            self.graph.node("Transpose", queries, perm=[0, 2, 1, 3]),
            self.graph.node("Transpose", keys, perm=[0, 2, 3, 1]),
        )
        attention = self.graph.node("Softmax", scores, axis=-1)
        values = self.graph.node("Transpose", values, perm=[0, 2, 1, 3])
        attended = self.graph.node("MatMul", attention, values)
        attended = self.graph.node("Transpose", attended, perm=[0, 2, 1, 3])
        attended = self.dense(self.shaped(attended, -1, self.width), *self.linear(f"{name}.attended"))
        return self.dense_part(name, self.graph.node("Add", tokens, attended))

    def last_block(self, name: str, tokens: str) -> str:
        """One block for the class token alone, (n, width)."""
        (to_queries, to_keys, to_values), (query_bias, _, value_bias) = self.queries_keys_values(name)
        tokens = self.shaped(tokens, -1, self.length, self.width)
        normalised = self.normalised(f"{name}.before_attention", tokens)
        place = self.graph.constant(0, np.int64)
        first = self.graph.node("Gather", tokens, place, axis=1)
        query = self.dense(self.graph.node("Gather", normalised, place, axis=1), to_queries, query_bias)
        # One copy of the query a head, each with the other heads' columns cleared.
        of_head = np.kron(np.eye(self.heads), np.ones(self.size))
        own = self.graph.constant(of_head)
        queries = self.graph.node("Mul", self.shaped(query, -1, 1, self.width), own)
        scores = self.graph.node(
            "MatMul",
            self.graph.node("MatMul", queries, self.graph.constant(to_keys.T)),
            self.graph.node("Transpose", normalised, perm=[0, 2, 1]),
        )
        means = self.graph.node("MatMul", self.graph.node("Softmax", scores, axis=-1), normalised)
        values = self.graph.node("MatMul", means, self.graph.constant(to_values))
        heads = self.graph.node("Mul", values, own)
        value = self.graph.node("ReduceSum", heads, self.graph.constant([1], np.int64), keepdims=0)
        weights, bias = self.linear(f"{name}.attended")
        attended = self.dense(value, weights, value_bias @ weights + bias)
        return self.dense_part(name, self.graph.node("Add", first, attended))

    def dense_part(self, name: str, tokens: str) -> str:
        """A block's two dense layers, added to what they take."""
        hidden = self.dense(self.normalised(f"{name}.before_dense", tokens), *self.linear(f"{name}.widen"))
        narrow = self.dense(self.graph.node("Gelu", hidden), *self.linear(f"{name}.narrow"))
        return self.graph.node("Add", tokens, narrow)

    def queries_keys_values(self, name: str) -> tuple[list[Array], list[Array]]:
        """Weights and biases of the three, with the attention's scale in the queries."""
        weights, bias = self.linear(f"{name}.queries_keys_values")
        scale = np.repeat([1 / math.sqrt(self.size), 1, 1], self.width)
        return np.split(weights * scale, 3, axis=1), np.split(bias * scale, 3)

    def linear(self, name: str) -> tuple[Array, Array]:
        """A layer's weights (in, out) and bias (out)."""
        return self.values[f"{name}.weight"].T, self.values[f"{name}.bias"]

    def dense(self, value: str, weights: Array, bias: Array) -> str:
        """Weights and bias on the rows of (rows, in)."""
        return self.graph.node("Gemm", value, self.graph.constant(weights), self.graph.constant(bias))

    def normalised(self, name: str, value: str) -> str:
        """A layer normalisation over the last axis."""
        parts = (self.graph.constant(self.values[f"{name}.{part}"]) for part in ("weight", "bias"))
        return self.graph.node("LayerNormalization", value, *parts, axis=-1, epsilon=_EPSILON)

    def shaped(self, value: str, *shape: int) -> str:
        """The same numbers in another shape; -1 is whatever is left."""
        return self.graph.node("Reshape", value, self.graph.constant(shape, np.int64))
