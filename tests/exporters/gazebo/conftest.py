"""Writes files in the plugin's format, and says what their networks predict, in plain NumPy."""

import base64
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from taxel.errors import ArtifactError
from taxel_exporters.gazebo.importer import import_network

PLUGIN_OUTPUTS = ["pac0", "pac1", "pdc", "tac", *(f"electrodes{number}" for number in range(19))]
SERVED = [column for column, name in enumerate(PLUGIN_OUTPUTS) if name not in ("pac1", "tac")]

Columns = dict[str, np.ndarray]


def encoded(array: np.ndarray) -> Any:
    if array.ndim == 1:
        return base64.b64encode(array.astype("<f4").tobytes()).decode()
    return [encoded(row) for row in array]


def input_layer(name: str) -> dict[str, Any]:
    config = {"batch_input_shape": (None, 13), "dtype": "float32", "sparse": False, "name": name}
    return {"class_name": "InputLayer", "name": name, "config": config, "inbound_nodes": []}


def dense_layer(name: str, source: str, units: int, activation: str, use_bias: bool) -> dict[str, Any]:
    config = {
        "name": name,
        "units": units,
        "activation": activation,
        "use_bias": use_bias,
        "trainable": use_bias,
        "kernel_initializer": {"class_name": "VarianceScaling", "config": {"scale": 1.0, "seed": None}},
    }
    return {"class_name": "Dense", "name": name, "config": config, "inbound_nodes": [[[source, 0, 0, {}]]]}


def merge_layer(kind: str, name: str, sources: list[str]) -> dict[str, Any]:
    inbound = [[source, 0, 0, {}] for source in sources]
    return {"class_name": kind, "name": name, "config": {"name": name}, "inbound_nodes": [inbound]}


@dataclass
class PluginModel:
    """A small network of Network B's form, and its file's content, open to damage."""

    content: dict[str, Any]
    arrays: dict[str, list[np.ndarray]]
    statistics: dict[str, tuple[np.ndarray, np.ndarray]]

    def layer(self, name: str) -> dict[str, Any]:
        return self.content["layers"]["layers"][self.position(name)]

    def weights(self, name: str) -> list[Any]:
        return self.content["weights"][self.position(name)]

    def position(self, name: str) -> int:
        return [layer["name"] for layer in self.content["layers"]["layers"]].index(name)

    def text(self) -> str:
        return yaml.dump(self.content)

    def write(self, folder: Path) -> Path:
        path = folder / "model.yaml"
        path.write_text(self.text())
        return path

    def predict(self, columns: Columns) -> np.ndarray:
        """Our 21 channels (n, 21) of named columns: position, force, next, last (n, 3), and tdc (n,)."""
        order = [columns[name] for name in ("position", "force", "next", "last")]
        rows = np.column_stack([*order, columns["tdc"]]).astype(np.float64)
        center, scale = self.statistics["input"]
        z = (rows - center) / scale
        place = self._dense("place_out", np.maximum(self._dense("place_in", z[:, 0:3]), 0))
        touch = self._dense("touch_out", np.maximum(self._dense("touch_in", z[:, 3:12]), 0))
        trunk = self._dense("trunk_out", np.maximum(self._dense("trunk_in", touch * place), 0))
        warmth = self._dense("warm_out", 1 / (1 + np.exp(-self._dense("warm_in", z[:, 12:13]))))
        center, scale = self.statistics["output"]
        return ((warmth + trunk) * scale + center)[:, SERVED]

    def _dense(self, name: str, values: np.ndarray) -> np.ndarray:
        matrix, bias = self.arrays[name]
        return values @ matrix.astype(np.float64) + bias


def selector(first: int, last: int) -> np.ndarray:
    return np.eye(13, dtype=np.float32)[:, first:last]


def network_b() -> PluginModel:
    rng = np.random.default_rng(5)
    layers = [input_layer("Input")]
    arrays: dict[str, list[np.ndarray]] = {"Input": []}
    widths = {"Input": 13}

    def dense(name: str, source: str, units: int, activation: str) -> None:
        layers.append(dense_layer(name, source, units, activation, use_bias=True))
        matrix = rng.normal(size=(widths[source], units)) / np.sqrt(widths[source])
        arrays[name] = [matrix.astype(np.float32), rng.normal(size=units).astype(np.float32)]
        widths[name] = units

    def merge(kind: str, name: str, sources: list[str]) -> None:
        layers.append(merge_layer(kind, name, sources))
        arrays[name], widths[name] = [], widths[sources[0]]

    for name, first, last in (("place_pick", 0, 3), ("touch_pick", 3, 12), ("warm_pick", 12, 13)):
        layers.append(dense_layer(name, "Input", last - first, "linear", use_bias=False))
        arrays[name], widths[name] = [selector(first, last)], last - first
    dense("place_in", "place_pick", 8, "relu")
    dense("touch_in", "touch_pick", 7, "relu")
    dense("place_out", "place_in", 6, "linear")
    dense("touch_out", "touch_in", 6, "linear")
    merge("Multiply", "product", ["touch_out", "place_out"])
    dense("warm_in", "warm_pick", 5, "sigmoid")
    dense("trunk_in", "product", 9, "relu")
    dense("warm_out", "warm_in", 23, "linear")
    dense("trunk_out", "trunk_in", 23, "linear")
    merge("Add", "sum", ["warm_out", "trunk_out"])

    statistics = {
        "input": (np.append(rng.normal(size=12), 1968.75), np.append(rng.uniform(0.5, 2, 12), 40.0)),
        "output": (rng.uniform(1000, 3000, 23), rng.uniform(20, 200, 23)),
    }
    content = {
        "layers": {
            "name": "model_1",
            "layers": layers,
            "input_layers": [["Input", 0, 0]],
            "output_layers": [["sum", 0, 0]],
        },
        "weights": [[encoded(array) for array in arrays[layer["name"]]] for layer in layers],
        "normalization": {
            part: {"center": center.tolist(), "scale": scale.tolist()}
            for part, (center, scale) in statistics.items()
        },
    }
    return PluginModel(content, arrays, statistics)


@pytest.fixture
def model() -> PluginModel:
    return network_b()


@pytest.fixture
def draw() -> Callable[[PluginModel, int], Columns]:
    def of(model: PluginModel, rows: int) -> Columns:
        center, scale = model.statistics["input"]
        values = (np.random.default_rng(1).normal(size=(rows, 13)) * scale + center).astype(np.float32)
        named = {"position": values[:, 0:3], "force": values[:, 3:6], "next": values[:, 6:9]}
        return {**named, "last": values[:, 9:12], "tdc": values[:, 12]}

    return of


@pytest.fixture
def refusal() -> Callable[[Path], str]:
    """The text of the error that refuses a file. It must be short, and nothing may be written."""

    def refuse(path: Path) -> str:
        repository = path.parent / "repository"
        with pytest.raises(ArtifactError) as caught:
            import_network(path, repository, name="finger")
        assert len(str(caught.value)) < 600
        assert not repository.exists()
        return str(caught.value)

    return refuse
