"""Network B of Ruppel et al. 2018: columns for position and force that multiply, and one for temperature.

The position and the force column end in linear layers of equal width. Their outputs are multiplied
element by element. A trunk maps the product to the outputs, and the temperature column is added to them.
"""

from typing import Annotated

from pydantic import Field, model_validator
from torch import Tensor, nn
from typing_extensions import override

from taxel_models.families.networks.network import NetworkFamily, Shape
from taxel_models.families.networks.recipe import Recipe

Widths = Annotated[tuple[Annotated[int, Field(ge=1)], ...], Field(min_length=1)]


class NetworkBHyperparameters(Recipe):
    """The published widths and recipe."""

    position_column: Widths
    force_column: Widths
    temperature_column: tuple[Annotated[int, Field(ge=1)]]
    trunk: Widths

    @model_validator(mode="after")
    def _columns_meet(self) -> "NetworkBHyperparameters":
        ends = self.position_column[-1], self.force_column[-1]
        if ends[0] != ends[1]:
            raise ValueError(
                f"position and force column end with {ends[0]} and {ends[1]} units: cannot multiply"
            )
        return self


class _NetworkB(nn.Module):
    def __init__(self, shape: Shape, chosen: NetworkBHyperparameters) -> None:
        super().__init__()
        self.positions, self.length = shape.positions, shape.spec.length
        self.position_column = _dense(self.positions, chosen.position_column)
        self.force_column = _dense(self.length - self.positions, chosen.force_column)
        self.trunk = nn.Sequential(
            _dense(chosen.position_column[-1], chosen.trunk, last_linear=False),
            nn.Linear(chosen.trunk[-1], shape.outputs),
        )
        self.temperature_column: nn.Module | None = None
        if shape.extras:
            self.temperature_column = nn.Sequential(
                nn.Linear(len(shape.extras), chosen.temperature_column[0]),
                nn.Sigmoid(),
                nn.Linear(chosen.temperature_column[0], shape.outputs),
            )

    def forward(self, columns: Tensor) -> Tensor:
        place = self.position_column(columns[:, : self.positions])
        force = self.force_column(columns[:, self.positions : self.length])
        outputs: Tensor = self.trunk(place * force)
        if self.temperature_column is not None:
            outputs = outputs + self.temperature_column(columns[:, self.length :])
        return outputs


def _dense(width: int, widths: tuple[int, ...], *, last_linear: bool = True) -> nn.Sequential:
    layers: list[nn.Module] = []
    for neurons in widths:
        layers += [nn.Linear(width, neurons), nn.ReLU()]
        width = neurons
    return nn.Sequential(*(layers[:-1] if last_linear else layers))


class NetworkBFamily(NetworkFamily):
    """Position times force, plus temperature."""

    name = "network-b"
    hyperparameters = NetworkBHyperparameters
    extras = ("tdc",)
    auxiliary_outputs = 2

    @override
    def build(self, shape: Shape, hyperparameters: NetworkBHyperparameters) -> nn.Module:
        return _NetworkB(shape, hyperparameters)
