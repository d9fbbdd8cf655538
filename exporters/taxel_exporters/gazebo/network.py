"""A checked network of the plugin, and what it predicts in double precision."""

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from taxel.errors import ArtifactError
from taxel_exporters.gazebo.document import short

_LARGEST: Final = 1e18
"""The largest value in a layer: far enough below the largest float32, so sums stay finite, too."""

Activation = Literal["linear", "relu", "sigmoid"]
Operation = Literal["Multiply", "Add"]


@dataclass(frozen=True)
class Dense:
    """A dense layer: weights (in, out), bias (out,) or none."""

    name: str
    source: str
    weights: NDArray[np.float32]
    bias: NDArray[np.float32] | None
    activation: Activation


@dataclass(frozen=True)
class Merge:
    """A layer that multiplies or adds others, value by value."""

    name: str
    sources: tuple[str, ...]
    operation: Operation


@dataclass(frozen=True)
class Statistics:
    """Mean and standard deviation by column."""

    mean: tuple[float, ...]
    std: tuple[float, ...]


@dataclass(frozen=True)
class Network:
    """Layers in order of execution; each takes the input or layers before it, by their names.

    Attributes:
        inputs: statistics of `columns.INPUTS`.
        outputs: statistics of `columns.OUTPUTS`.
    """

    input_name: str
    layers: tuple[Dense | Merge, ...]
    output_name: str
    inputs: Statistics
    outputs: Statistics

    @property
    def parameters(self) -> int:
        """Weights and biases."""
        dense = (layer for layer in self.layers if isinstance(layer, Dense))
        return sum(layer.weights.size + (0 if layer.bias is None else layer.bias.size) for layer in dense)

    def evaluate(self, rows: NDArray[np.float64]) -> NDArray[np.float64]:
        """The values of `columns.OUTPUTS` (n, 23) for those of `columns.INPUTS` (n, 13), in float64.

        Raises:
            ArtifactError: a layer's values are too large for float32, in which it will be served.
        """
        values = {self.input_name: (rows - self.inputs.mean) / self.inputs.std}
        for layer in self.layers:
            with np.errstate(over="ignore", invalid="ignore"):
                found = _evaluated(layer, values)
            if not np.abs(found).max() < _LARGEST:
                raise ArtifactError(f"layer {short(layer.name)}: its values overflow on usual inputs")
            values[layer.name] = found
        restored: NDArray[np.float64] = values[self.output_name] * self.outputs.std + self.outputs.mean
        return restored


def _evaluated(layer: Dense | Merge, values: dict[str, NDArray[np.float64]]) -> NDArray[np.float64]:
    if isinstance(layer, Dense):
        return _dense(layer, values[layer.source])
    combine = np.multiply if layer.operation == "Multiply" else np.add
    result: NDArray[np.float64] = combine.reduce([values[name] for name in layer.sources])
    return result


def _dense(layer: Dense, values: NDArray[np.float64]) -> NDArray[np.float64]:
    weighted = values @ layer.weights.astype(np.float64)
    if layer.bias is not None:
        weighted = weighted + layer.bias
    if layer.activation == "relu":
        return np.maximum(weighted, 0.0)
    if layer.activation == "sigmoid":
        return 0.5 * (1.0 + np.tanh(0.5 * weighted))
    return weighted
