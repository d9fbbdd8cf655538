"""The families by name. To add one, write its file and name it here."""

from collections.abc import Callable
from importlib import import_module
from typing import Any, Final

from pydantic import ValidationError

from taxel.artifacts import describe
from taxel.errors import SettingsError
from taxel_models.families.family import Family, Hyperparameters

_HOMES: Final = {
    "xgb": "taxel_models.families.xgb:XgbFamily",
    "ffnn": "taxel_models.families.networks.ffnn:FfnnFamily",
    "transformer": "taxel_models.families.networks.transformer:TransformerFamily",
    "network-a": "taxel_models.families.networks.network_a:NetworkAFamily",
    "network-b": "taxel_models.families.networks.network_b:NetworkBFamily",
    "ensemble": "taxel_models.families.ensemble:EnsembleFamily",
}

FAMILIES: Final = tuple(_HOMES)


def family(name: str) -> Family:
    """The family of this name. Its library is imported only here.

    Raises:
        SettingsError: there is no such family.
    """
    if name not in _HOMES:
        raise SettingsError(f"model {name!r}: expected one of {', '.join(FAMILIES)}")
    module, _, attribute = _HOMES[name].partition(":")
    make: Callable[[], Family] = getattr(import_module(module), attribute)
    return make()


def resolve(kind: Family, combination: int, overrides: dict[str, Any]) -> Hyperparameters:
    """The paper's hyperparameters for a combination with some replaced.

    Raises:
        SettingsError: an override is unknown or not valid.
    """
    chosen = kind.choose(combination, overrides)
    try:
        return kind.hyperparameters.model_validate(chosen)
    except ValidationError as error:
        known = ", ".join(kind.hyperparameters.model_fields)
        raise SettingsError(f"hyperparameters of {kind.name}: {describe(error)} (known: {known})") from None
