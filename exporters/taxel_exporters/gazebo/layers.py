"""Reads the layers of a `model.yaml` with their weights, checked one by one; errors name the layer."""

from dataclasses import dataclass, field
from typing import Annotated, Any, Final, Literal, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from taxel.artifacts import describe
from taxel.errors import ArtifactError
from taxel_exporters.gazebo.columns import INPUTS, OUTPUTS
from taxel_exporters.gazebo.document import Tree, layer_label, short
from taxel_exporters.gazebo.network import Activation, Dense, Merge, Operation
from taxel_exporters.gazebo.weights import decode_matrix, decode_vector

MAX_LAYERS: Final = 512
MAX_PARAMETERS: Final = 1 << 25
"""Five times the largest published network's."""

MAX_WIDTH: Final = 1 << 16
"""The most values in all layers together: one evaluation holds them for each row."""

_SHOWN: Final = 300
"""The most characters of one error: a hostile file may be wrong in a million places."""

Name = Annotated[str, Field(min_length=1, max_length=200)]
_Index = Literal["0"]


class Part(BaseModel):
    """A part of the document; what an evaluation does not need is ignored."""

    # Keras writes more: initialisers, regularisers, whether to train.
    model_config = ConfigDict(extra="ignore", frozen=True)


class _DenseConfig(Part):
    units: Annotated[int, Field(ge=1, le=MAX_WIDTH)]
    activation: Activation
    use_bias: bool


class _InputConfig(Part):
    batch_input_shape: tuple[str, Annotated[int, Field(ge=len(INPUTS), le=len(INPUTS))]] | None = None


class _Layer(Part):
    class_name: Literal["InputLayer", "Dense", "Multiply", "Add"]
    name: Name
    config: dict[str, Any]
    inbound_nodes: Annotated[list[list[list[Any]]], Field(max_length=1)]


class Graph(Part):
    """The `layers` of the document: a Keras functional model's configuration."""

    layers: Annotated[list[Any], Field(min_length=1, max_length=MAX_LAYERS)]
    input_layers: tuple[tuple[Name, _Index, _Index]]
    output_layers: tuple[tuple[Name, _Index, _Index]]


_P = TypeVar("_P", bound=BaseModel)


def parse(kind: type[_P], tree: Tree, where: str) -> _P:
    """A part of the document as a checked model.

    Raises:
        ArtifactError: it does not match that model.
    """
    try:
        return kind.model_validate(tree)
    except ValidationError as error:
        faults = describe(error)
        shown = faults if len(faults) <= _SHOWN else f"{faults[:_SHOWN]}…"
        raise ArtifactError(f"{where}: {shown}") from None


@dataclass
class LayerReader:
    """Reads layers one after another, and knows how wide those before are.

    Attributes:
        document: the whole document, for the names in messages.
        source: the file's, likewise.
        widths: values that each layer so far gives, by its name.
    """

    document: Tree
    source: str
    widths: dict[str, int] = field(default_factory=dict)
    layers: list[Dense | Merge] = field(default_factory=list)
    input_name: str | None = None
    parameters: int = 0

    def read(self, position: int, tree: Tree, weights: Tree) -> None:
        """Read the layer at a position of the list, with its entry in `weights`.

        Raises:
            ArtifactError: it is outside the format, or contradicts its weights or earlier layers.
        """
        where = f"{self.source}: {layer_label(self.document, position)}"
        layer = parse(_Layer, tree, where)
        if layer.name in self.widths:
            raise ArtifactError(f"{where}: a layer before it has the same name")
        if not isinstance(weights, list):
            raise ArtifactError(f"{where}: weights: expected a list of arrays")
        sources = self._sources(layer, where)
        if layer.class_name == "Dense":
            width = self._dense(layer, sources, weights, where)
        else:
            if weights:
                raise ArtifactError(f"{where}: {len(weights)} arrays of weights: expected none")
            is_input = layer.class_name == "InputLayer"
            width = self._input(layer, where) if is_input else self._merge(layer, sources, where)
        self.widths[layer.name] = width
        if sum(self.widths.values()) > MAX_WIDTH:
            raise ArtifactError(f"{where}: expected at most {MAX_WIDTH} values in all layers together")

    def _sources(self, layer: _Layer, where: str) -> tuple[str, ...]:
        """The layers that it takes, all of them read before."""
        names = []
        for entry in layer.inbound_nodes[0] if layer.inbound_nodes else []:
            name = entry[0] if entry else None
            if not isinstance(name, str) or any(index != "0" for index in entry[1:3]):
                raise ArtifactError(f"{where}: inbound_nodes: expected [layer name, 0, 0] for each input")
            if name not in self.widths:
                raise ArtifactError(
                    f"{where}: takes {short(name)}, which is no layer before it in the list: "
                    "expected layers in order of execution"
                )
            names.append(name)
        low, high = {"InputLayer": (0, 0), "Dense": (1, 1)}.get(layer.class_name, (2, MAX_LAYERS))
        if not low <= len(names) <= high:
            expected = low if low == high else f"at least {low}"
            raise ArtifactError(f"{where}: {len(names)} inbound layers: expected {expected}")
        return tuple(names)

    def _input(self, layer: _Layer, where: str) -> int:
        if self.input_name is not None:
            raise ArtifactError(f"{where}: a second InputLayer: expected one")
        parse(_InputConfig, layer.config, f"{where}: config")
        self.input_name = layer.name
        return len(INPUTS)

    def _dense(self, layer: _Layer, sources: tuple[str, ...], weights: list[Tree], where: str) -> int:
        config = parse(_DenseConfig, layer.config, f"{where}: config")
        (source,) = sources
        arrays = 2 if config.use_bias else 1
        if len(weights) != arrays:
            with_bias = "a matrix and a bias" if config.use_bias else "a matrix alone, without bias"
            raise ArtifactError(f"{where}: {len(weights)} arrays of weights: expected {with_bias}")
        self.parameters += (self.widths[source] + config.use_bias) * config.units
        if self.parameters > MAX_PARAMETERS:
            raise ArtifactError(f"{where}: expected at most {MAX_PARAMETERS} parameters up to here")
        matrix = decode_matrix(weights[0], self.widths[source], config.units, f"{where}: weights")
        bias = decode_vector(weights[1], config.units, f"{where}: bias") if config.use_bias else None
        self.layers.append(Dense(layer.name, source, matrix, bias, config.activation))
        return config.units

    def _merge(self, layer: _Layer, sources: tuple[str, ...], where: str) -> int:
        widths = [self.widths[name] for name in sources]
        if len(set(widths)) != 1:
            raise ArtifactError(f"{where}: takes layers of {widths} values: expected equal widths")
        operation: Operation = "Multiply" if layer.class_name == "Multiply" else "Add"
        self.layers.append(Merge(layer.name, sources, operation))
        return widths[0]

    def output(self, name: str) -> str:
        """The output layer's name, now that all are read.

        Raises:
            ArtifactError: there is no such layer, or it does not give the plugin's outputs.
        """
        where = f"{self.source}: output layer {short(name)}"
        if name not in self.widths:
            raise ArtifactError(f"{where}: not among the layers")
        if self.widths[name] != len(OUTPUTS):
            raise ArtifactError(f"{where}: gives {self.widths[name]} values: expected {len(OUTPUTS)}")
        return name
