"""The paper's hyperparameters, found with SMAC3, by family and input combination."""

import json
from functools import cache
from importlib.resources import files
from typing import Any

from taxel.errors import SettingsError


@cache
def _tables() -> dict[str, Any]:
    text = (files("taxel_models.families") / "published.json").read_text(encoding="utf-8")
    tables: dict[str, Any] = json.loads(text)
    return tables


def published(family: str, combination: int) -> dict[str, Any]:
    """The published hyperparameters of a family for input combination 1..8.

    Raises:
        SettingsError: the paper gives none.
    """
    try:
        return dict(_tables()[family][str(combination)])
    except KeyError:
        raise SettingsError(f"no published hyperparameters for {family}, inputs {combination}") from None


def published_parameters(family: str, combination: int) -> int:
    """The published number of parameters, rounded to thousands as the paper prints it."""
    return 1000 * int(_tables()["parameters_k"][family][str(combination)])
