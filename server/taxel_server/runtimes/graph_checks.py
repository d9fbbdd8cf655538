"""What an ONNX file may not hold, seen before anything of it is computed."""

from collections.abc import Iterable, Iterator
from itertools import chain
from pathlib import Path
from typing import Final

import onnx
from google.protobuf.message import DecodeError
from onnx import AttributeProto, GraphProto, NodeProto, TensorProto

from taxel.errors import ArtifactError

LOOPS: Final = frozenset({"Loop", "Scan", "SequenceMap", "BeamSearch", "GreedySearch", "Sampling"})
"""Operations that repeat a graph. How often may depend on the window, so no trial can tell the time."""


def check_graph(path: Path) -> None:
    """Raise if an ONNX file holds a loop, or keeps its weights in other files.

    Raises:
        ArtifactError: it does, or is no ONNX file.
    """
    try:
        model = onnx.load(path, load_external_data=False)
    except (DecodeError, OSError) as error:
        raise ArtifactError(f"{path}: no ONNX file: {error}") from None
    nodes = chain(_nodes(model.graph), *(_nodes_below(function.node) for function in model.functions))
    for node in nodes:
        if node.op_type in LOOPS:
            raise ArtifactError(f"{path}: node {node.name!r} is a {node.op_type}: expected no loops")
        for attribute in node.attribute:
            _check_inside(path, (attribute.t, attribute.sparse_tensor.values, *attribute.tensors))
    for graph in _graphs(model.graph):
        _check_inside(path, graph.initializer)
        _check_inside(path, (sparse.values for sparse in graph.sparse_initializer))


def _check_inside(path: Path, tensors: Iterable[TensorProto]) -> None:
    for tensor in tensors:
        if tensor.data_location == TensorProto.EXTERNAL or tensor.external_data:
            raise ArtifactError(
                f"{path}: tensor {tensor.name!r} lies in another file: expected it in this one"
            )


def _graphs(graph: GraphProto) -> Iterator[GraphProto]:
    """A graph and those inside its nodes."""
    waiting = [graph]
    while waiting:
        current = waiting.pop()
        yield current
        for node in current.node:
            waiting.extend(_inside(node))


def _inside(node: NodeProto) -> Iterator[GraphProto]:
    for attribute in node.attribute:
        if attribute.type == AttributeProto.GRAPH:
            yield attribute.g
        yield from attribute.graphs


def _nodes(graph: GraphProto) -> Iterator[NodeProto]:
    for each in _graphs(graph):
        yield from each.node


def _nodes_below(nodes: Iterable[NodeProto]) -> Iterator[NodeProto]:
    for node in nodes:
        yield node
        for graph in _inside(node):
            yield from _nodes(graph)
