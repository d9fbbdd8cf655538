"""The paper's search spaces, and how a configuration in one becomes a family's hyperparameters.

Source: Zai El Amri and Navarro-Guerrero, IJCNN 2024, supplement. Network B was not searched: its
published hyperparameters are Ruppel et al.'s.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final

from ConfigSpace import (
    Categorical,
    ConfigurationSpace,
    EqualsCondition,
    Float,
    GreaterThanCondition,
    Integer,
    OrConjunction,
)
from ConfigSpace.hyperparameters import Hyperparameter

from taxel.errors import SettingsError

LEARNING_RATES: Final = [float(f"{digit}e-{power}") for power in range(5, 1, -1) for digit in range(1, 10)]
BATCH_SIZES: Final = [256, 512]

LAYERS: Final = (4, 12)
"""Layers of the feed-forward network, output layer included."""

ACTIVATIONS: Final = ["sigmoid", "relu", "hardtanh", "tanh", "leakyrelu", "elu"]


@dataclass(frozen=True)
class SearchSpace:
    """A family's space.

    Attributes:
        build: makes the space, without the hyperparameters of these names.
        decode: a configuration's values as hyperparameters of the family.
        by_epochs: a trial's budget is a number of epochs.
        names: hyperparameters that may be set instead of searched.
    """

    build: Callable[[frozenset[str]], ConfigurationSpace]
    decode: Callable[[Mapping[str, Any]], dict[str, Any]]
    by_epochs: bool
    names: frozenset[str]


def search_space(family: str) -> SearchSpace:
    """The space of a family.

    Raises:
        SettingsError: the paper gives none.
    """
    if family not in _SPACES:
        raise SettingsError(f"model {family!r} has no search space: expected one of {', '.join(_SPACES)}")
    return _SPACES[family]


def _without(names: frozenset[str], *found: Hyperparameter) -> ConfigurationSpace:
    space = ConfigurationSpace()
    space.add([parameter for parameter in found if parameter.name not in names])
    return space


_XGB: Final = (
    Float("eta", (1e-4, 0.5)),
    Integer("gamma", (0, 10)),
    Integer("n_estimators", (100, 1000)),
    Integer("max_depth", (1, 10)),
    Integer("min_child_weight", (1, 100)),
    Integer("max_delta_step", (0, 10)),
    Float("subsample", (0.5, 1.0)),
    Float("colsample_bytree", (0.5, 1.0)),
    Float("colsample_bylevel", (0.5, 1.0)),
    Float("colsample_bynode", (0.5, 1.0)),
)

_RECIPE: Final = (
    Categorical("batch_size", BATCH_SIZES, ordered=True),
    Categorical("learning_rate", LEARNING_RATES, ordered=True),
)

_TRANSFORMER: Final = (
    *_RECIPE,
    Integer("layers", (2, 8)),
    Categorical("heads", [1, 2, 4, 8], ordered=True),
    Categorical("dropout", [0.0, 0.1, 0.2, 0.3, 0.4, 0.5], ordered=True),
    Categorical("embedding", [32, 64, 128, 256, 512, 1024], ordered=True),
    Categorical("hidden", [64, 128, 256, 512, 1024], ordered=True),
)


def _ffnn(without: frozenset[str]) -> ConfigurationSpace:
    """Width (in tens of neurons) and activation of each layer. Only the first `layers` layers are used."""
    space = _without(without, *_RECIPE)
    least, most = LAYERS
    layers = Integer("layers", LAYERS)
    widths = [Integer(f"tens_{number}", (5, 100)) for number in range(1, most + 1)]
    activations = [Categorical(f"activation_{number}", ACTIVATIONS) for number in range(1, most + 1)]
    space.add(layers, *widths, *activations)
    for number in range(least + 1, most + 1):
        for child in (widths[number - 1], activations[number - 1]):
            space.add(GreaterThanCondition(child, layers, number - 1))
    if "leaky_relu_negative_slope" not in without:
        slope = Categorical(
            "leaky_relu_negative_slope", [digit / 10 for digit in range(1, 10)], ordered=True
        )
        space.add(slope)
        leaky = [EqualsCondition(slope, activation, "leakyrelu") for activation in activations]
        space.add(OrConjunction(*leaky))
    return space


def _ffnn_hyperparameters(values: Mapping[str, Any]) -> dict[str, Any]:
    numbers = range(1, values["layers"] + 1)
    others = {
        name: value
        for name, value in values.items()
        if name != "layers" and not name.startswith(("tens_", "activation_"))
    }
    return {
        **others,
        "neurons": [10 * values[f"tens_{number}"] for number in numbers],
        "activations": [values[f"activation_{number}"] for number in numbers],
    }


def _names(found: tuple[Hyperparameter, ...]) -> frozenset[str]:
    return frozenset(parameter.name for parameter in found)


_SPACES: Final = {
    "xgb": SearchSpace(lambda without: _without(without, *_XGB), dict, False, _names(_XGB)),
    "ffnn": SearchSpace(
        _ffnn, _ffnn_hyperparameters, True, _names(_RECIPE) | {"leaky_relu_negative_slope"}
    ),
    "transformer": SearchSpace(
        lambda without: _without(without, *_TRANSFORMER), dict, True, _names(_TRANSFORMER)
    ),
}
