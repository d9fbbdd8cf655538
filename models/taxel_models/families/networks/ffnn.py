"""The paper's feed-forward network (Zai El Amri and Navarro-Guerrero, IJCNN 2024, supplement).

The published number of layers includes the output layer: a list of L widths means L - 1 hidden layers and
the output. Its last width and activation are not used. Only so do the parameter counts agree with the
published ones.
"""

from typing import Annotated, Final, Literal

from pydantic import Field, model_validator
from torch import nn
from typing_extensions import override

from taxel_models.families.networks.network import NetworkFamily, Shape
from taxel_models.families.networks.recipe import Recipe

Activation = Literal["sigmoid", "relu", "hardtanh", "tanh", "leakyrelu", "elu"]

_ACTIVATIONS: Final = {
    "sigmoid": nn.Sigmoid,
    "relu": nn.ReLU,
    "hardtanh": nn.Hardtanh,
    "tanh": nn.Tanh,
    "elu": nn.ELU,
}


class FfnnHyperparameters(Recipe):
    """The paper's search space."""

    neurons: Annotated[tuple[Annotated[int, Field(ge=1)], ...], Field(min_length=2)]
    activations: tuple[Activation, ...]
    leaky_relu_negative_slope: Annotated[float, Field(ge=0, le=1)] = 0.01

    @model_validator(mode="after")
    def _as_many_activations_as_widths(self) -> "FfnnHyperparameters":
        if len(self.activations) != len(self.neurons):
            raise ValueError(f"{len(self.activations)} activations for {len(self.neurons)} widths")
        return self


class FfnnFamily(NetworkFamily):
    """Dense layers, each with a width and an activation of its own."""

    name = "ffnn"
    hyperparameters = FfnnHyperparameters

    @override
    def build(self, shape: Shape, hyperparameters: FfnnHyperparameters) -> nn.Module:
        layers: list[nn.Module] = []
        width = shape.spec.length
        hidden = zip(hyperparameters.neurons[:-1], hyperparameters.activations[:-1], strict=True)
        for neurons, activation in hidden:
            layers.append(nn.Linear(width, neurons))
            if activation == "leakyrelu":
                layers.append(nn.LeakyReLU(hyperparameters.leaky_relu_negative_slope))
            else:
                layers.append(_ACTIVATIONS[activation]())
            width = neurons
        return nn.Sequential(*layers, nn.Linear(width, shape.outputs))
