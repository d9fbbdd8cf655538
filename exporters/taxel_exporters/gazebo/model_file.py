"""Reads a `model.yaml` as a whole: its layers, weights and normalisation become one checked network."""

from typing import Annotated, Any, Final

from pydantic import Field

from taxel.errors import ArtifactError
from taxel_exporters.gazebo.columns import INPUTS, OUTPUTS
from taxel_exporters.gazebo.document import parse_document, short
from taxel_exporters.gazebo.layers import Graph, LayerReader, Part, parse
from taxel_exporters.gazebo.network import Network, Statistics

_LARGEST: Final = 1e18
"""The largest mean or standard deviation: products of such values stay finite in float32."""

_Mean = Annotated[float, Field(ge=-_LARGEST, le=_LARGEST)]
_Std = Annotated[float, Field(ge=1 / _LARGEST, le=_LARGEST)]


class _Inputs(Part):
    center: Annotated[tuple[_Mean, ...], Field(min_length=len(INPUTS), max_length=len(INPUTS))]
    scale: Annotated[tuple[_Std, ...], Field(min_length=len(INPUTS), max_length=len(INPUTS))]


class _Outputs(Part):
    center: Annotated[tuple[_Mean, ...], Field(min_length=len(OUTPUTS), max_length=len(OUTPUTS))]
    scale: Annotated[tuple[_Std, ...], Field(min_length=len(OUTPUTS), max_length=len(OUTPUTS))]


class _Normalization(Part):
    input: _Inputs
    output: _Outputs


class _Document(Part):
    layers: dict[str, Any]
    weights: list[Any]
    normalization: dict[str, Any]


def read_network(content: bytes, source: str) -> Network:
    """The network that the content of a `model.yaml` describes.

    Args:
        source: the file's name in messages.

    Raises:
        ArtifactError: the file is damaged, hostile, or is outside the plugin's format;
            the text names the layer.
    """
    tree = parse_document(content, source)
    document = parse(_Document, tree, source)
    statistics = parse(_Normalization, document.normalization, f"{source}: normalization")
    graph = parse(Graph, document.layers, f"{source}: layers")
    if len(document.weights) != len(graph.layers):
        raise ArtifactError(
            f"{source}: weights of {len(document.weights)} layers for {len(graph.layers)}: expected one "
            "list for each layer"
        )
    reader = LayerReader(tree, source)
    for position, (layer, weights) in enumerate(zip(graph.layers, document.weights, strict=True)):
        reader.read(position, layer, weights)
    (named,) = graph.input_layers
    if reader.input_name is None or named[0] != reader.input_name:
        raise ArtifactError(f"{source}: input layer {short(named[0])}: expected the layers' one InputLayer")
    (output,) = graph.output_layers
    return Network(
        input_name=reader.input_name,
        layers=tuple(reader.layers),
        output_name=reader.output(output[0]),
        inputs=Statistics(statistics.input.center, statistics.input.scale),
        outputs=Statistics(statistics.output.center, statistics.output.scale),
    )
