"""What all network families share: how a network is built, fitted, stored and evaluated."""

import json
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Final

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn
from typing_extensions import override

from taxel.channels import CHANNELS
from taxel.errors import ArtifactError
from taxel.windows import WindowSpec
from taxel_models.families.family import (
    NO_EXTRAS,
    Family,
    FitData,
    FitTask,
    FittedModel,
    History,
    Hyperparameters,
)
from taxel_models.families.networks.recipe import Recipe, Trainer, device
from taxel_models.families.published import published

_ROWS: Final = 8192
_SHAPE: Final = "network.json"
_WEIGHTS: Final = "weights.pt"


@dataclass(frozen=True)
class Shape:
    """The inputs and outputs of a network.

    Attributes:
        spec: its windows; their columns come first.
        extras: names of the extra inputs; their columns come last.
        outputs: 21 channels, and two auxiliary ones if the family is fitted to them.
    """

    spec: WindowSpec
    extras: tuple[str, ...]
    outputs: int

    @property
    def columns(self) -> int:
        """Of the window and the extras."""
        return self.spec.length + len(self.extras)

    @property
    def positions(self) -> int:
        """Columns that are positions; they come first."""
        return 3 * len(self.spec.positions)


class NetworkModel(FittedModel):
    """A trained network.

    Attributes:
        network: takes (n, columns), gives (n, outputs), z-scores; its first 21 outputs are served.
    """

    def __init__(self, network: nn.Module, shape: Shape, hyperparameters: Hyperparameters) -> None:
        self.network = network.eval()
        self.shape = shape
        self.hyperparameters = hyperparameters

    @property
    @override
    def parameters(self) -> int:
        return sum(part.numel() for part in self.network.parameters())

    @property
    @override
    def extras(self) -> tuple[str, ...]:
        return self.shape.extras

    @override
    def predict(
        self, windows: NDArray[np.float32], extras: Mapping[str, NDArray[np.float32]] = NO_EXTRAS
    ) -> NDArray[np.float32]:
        inputs = np.zeros((len(windows), self.shape.columns), np.float32)
        inputs[:, : windows.shape[1]] = windows
        for column, name in enumerate(self.shape.extras, windows.shape[1]):
            inputs[:, column] = extras.get(name, 0.0)
        place = next(self.network.parameters()).device
        outputs = np.empty((len(windows), len(CHANNELS)), np.float32)
        with torch.inference_mode():
            for start in range(0, len(windows), _ROWS):
                rows = torch.from_numpy(inputs[start : start + _ROWS]).to(place)
                outputs[start : start + _ROWS] = self.network(rows)[:, : len(CHANNELS)].cpu().numpy()
        return outputs

    @override
    def save(self, folder: Path) -> None:
        shape = {
            "combination": self.shape.spec.combination,
            "extras": self.shape.extras,
            "outputs": self.shape.outputs,
            "hyperparameters": self.hyperparameters.model_dump(mode="json"),
        }
        (folder / _SHAPE).write_text(json.dumps(shape, indent=1) + "\n", encoding="utf-8")
        weights = {name: value.cpu() for name, value in self.network.state_dict().items()}
        torch.save(weights, folder / _WEIGHTS)


class NetworkFamily(Family):
    """A family whose models are torch networks."""

    extras: ClassVar[tuple[str, ...]] = ()
    """Names of the extra inputs that it can take."""

    auxiliary_outputs: ClassVar[int] = 0
    """How many of the auxiliary channels it is fitted to beside the 21: `pac1` and `tac`, or none."""

    @classmethod
    def shape(cls, spec: WindowSpec, extras: Sequence[str]) -> Shape:
        """What a network of the family takes and gives, if these extras can be given."""
        taken = tuple(name for name in cls.extras if name in extras)
        return Shape(spec, taken, len(CHANNELS) + cls.auxiliary_outputs)

    @abstractmethod
    def build(self, shape: Shape, hyperparameters: Any) -> nn.Module:
        """A network with fresh weights, by torch's global generator."""

    @override
    def paper_hyperparameters(self, combination: int) -> Mapping[str, Any]:
        return published(self.name, combination)

    @override
    def fit(self, task: FitTask, hyperparameters: Hyperparameters) -> tuple[NetworkModel, History]:
        chosen = self.hyperparameters.model_validate(hyperparameters.model_dump())
        assert isinstance(chosen, Recipe)
        shape = self.shape(task.spec, task.extras)
        torch.manual_seed(task.seed)
        network = self.build(shape, chosen)
        parts = (task.train, task.validation)
        history = Trainer(
            network,
            (_inputs(parts[0], shape), _inputs(parts[1], shape)),
            (_targets(parts[0], shape), _targets(parts[1], shape)),
            chosen,
            task,
        ).train()
        return NetworkModel(network, shape, chosen), history

    @override
    def load(self, folder: Path) -> NetworkModel:
        try:
            kept = json.loads((folder / _SHAPE).read_text(encoding="utf-8"))
            shape = Shape(WindowSpec.of(kept["combination"]), _extras_of(kept), kept["outputs"])
            hyperparameters = self.hyperparameters.model_validate(kept["hyperparameters"])
            network = self.build(shape, hyperparameters)
            network.load_state_dict(torch.load(folder / _WEIGHTS, map_location="cpu", weights_only=True))
        except Exception as error:  # torch and pickle raise whatever they like on damaged files
            reason = str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__
            raise ArtifactError(
                f"{folder}: not a {self.name} network that training wrote: {reason}"
            ) from None
        return NetworkModel(network.to(device()), shape, hyperparameters)


def _extras_of(kept: Mapping[str, Any]) -> tuple[str, ...]:
    """Of `network.json`, which in Taxel 0.1 said only whether there is a temperature."""
    if "extras" in kept:
        return tuple(kept["extras"])
    return ("tdc",) if kept["temperature"] else ()


def _inputs(part: FitData, shape: Shape) -> NDArray[np.float32]:
    if not shape.extras:
        return np.ascontiguousarray(part.windows)
    return np.column_stack([part.windows, *(part.extras[name] for name in shape.extras)])


def _targets(part: FitData, shape: Shape) -> NDArray[np.float32]:
    if shape.outputs == len(CHANNELS):
        return np.ascontiguousarray(part.channels)
    return np.column_stack([part.channels, part.auxiliary])
