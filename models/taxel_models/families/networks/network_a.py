"""Network A of Ruppel et al. 2018: all inputs fused at the start, five wide hidden layers.

The paper gives five hidden layers and over 6 million parameters, but not the widths. Five layers of 1250
are our assumption.
"""

from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import Field
from torch import nn
from typing_extensions import override

from taxel_models.families.networks.network import NetworkFamily, Shape
from taxel_models.families.networks.recipe import Recipe
from taxel_models.families.published import published


class NetworkAHyperparameters(Recipe):
    """Widths of the hidden layers."""

    widths: tuple[Annotated[int, Field(ge=1)], ...] = (1250,) * 5


class NetworkAFamily(NetworkFamily):
    """One column of dense layers over position, force and temperature."""

    name = "network-a"
    hyperparameters = NetworkAHyperparameters
    extras = ("tdc",)
    auxiliary_outputs = 2

    @override
    def paper_hyperparameters(self, combination: int) -> Mapping[str, Any]:
        """The recipe of Network B: both were trained alike."""
        both = published("network-b", combination)
        return {name: both[name] for name in Recipe.model_fields if name in both}

    @override
    def build(self, shape: Shape, hyperparameters: NetworkAHyperparameters) -> nn.Module:
        layers: list[nn.Module] = []
        width = shape.columns
        for neurons in hyperparameters.widths:
            layers += [nn.Linear(width, neurons), nn.ReLU()]
            width = neurons
        return nn.Sequential(*layers, nn.Linear(width, shape.outputs))
