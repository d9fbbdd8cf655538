"""What all network families share: how a network is built, fitted, stored and evaluated."""

import json
from abc import abstractmethod
from collections.abc import Mapping
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
from taxel_models.families.family import Family, FitData, FitTask, FittedModel, History, Hyperparameters
from taxel_models.families.networks.recipe import Recipe, Trainer, device
from taxel_models.families.published import published

AUXILIARY_OUTPUTS: Final = 2
"""`pac1` and `tac`, which Ruppel et al. fitted beside the 21 channels."""

_ROWS: Final = 8192
_SHAPE: Final = "network.json"
_WEIGHTS: Final = "weights.pt"


@dataclass(frozen=True)
class Shape:
    """The inputs and outputs of a network.

    Attributes:
        spec: its windows; their columns come first.
        temperature: whether the last column is the temperature.
        outputs: 21 channels, and two auxiliary ones if the family is fitted to them.
    """

    spec: WindowSpec
    temperature: bool
    outputs: int

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
    def takes_temperature(self) -> bool:
        return self.shape.temperature

    @override
    def predict(
        self, windows: NDArray[np.float32], temperature: NDArray[np.float32] | None = None
    ) -> NDArray[np.float32]:
        columns = self.shape.spec.length + self.shape.temperature
        inputs = np.zeros((len(windows), columns), np.float32)
        inputs[:, : windows.shape[1]] = windows
        if self.shape.temperature and temperature is not None:
            inputs[:, -1] = temperature
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
            "temperature": self.shape.temperature,
            "outputs": self.shape.outputs,
            "hyperparameters": self.hyperparameters.model_dump(mode="json"),
        }
        (folder / _SHAPE).write_text(json.dumps(shape, indent=1) + "\n", encoding="utf-8")
        weights = {name: value.cpu() for name, value in self.network.state_dict().items()}
        torch.save(weights, folder / _WEIGHTS)


class NetworkFamily(Family):
    """A family whose models are torch networks."""

    uses_temperature: ClassVar[bool] = False
    """Whether it takes the temperature and is fitted to the auxiliary channels, as Ruppel's are."""

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
        shape = Shape(
            spec=task.spec,
            temperature=self.uses_temperature and task.with_temperature,
            outputs=len(CHANNELS) + AUXILIARY_OUTPUTS * self.uses_temperature,
        )
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
            shape = Shape(WindowSpec.of(kept["combination"]), kept["temperature"], kept["outputs"])
            hyperparameters = self.hyperparameters.model_validate(kept["hyperparameters"])
            network = self.build(shape, hyperparameters)
            network.load_state_dict(torch.load(folder / _WEIGHTS, map_location="cpu", weights_only=True))
        except Exception as error:  # torch and pickle raise whatever they like on damaged files
            reason = str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__
            raise ArtifactError(
                f"{folder}: not a {self.name} network that training wrote: {reason}"
            ) from None
        return NetworkModel(network.to(device()), shape, hyperparameters)


def _inputs(part: FitData, shape: Shape) -> NDArray[np.float32]:
    if not shape.temperature:
        return np.ascontiguousarray(part.windows)
    return np.column_stack([part.windows, part.temperature])


def _targets(part: FitData, shape: Shape) -> NDArray[np.float32]:
    if shape.outputs == len(CHANNELS):
        return np.ascontiguousarray(part.channels)
    return np.column_stack([part.channels, part.auxiliary])
