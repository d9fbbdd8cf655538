"""The paper's hyperparameters, found with SMAC3, and its inference table, by family and combination."""

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


def published_inference_ms(family: str, combination: int) -> float:
    """The published time of one prediction, ms, the mean over 100 windows.

    For a network, it is the time of all channels. For `xgb` it is the time of ONE channel, because the
    published script divides the sum over 21 regressors by 21.

    Raises:
        SettingsError: the paper gives none.
    """
    return float(_of_inference("inference_ms", family, combination))


def published_mflops(family: str, combination: int) -> float | None:
    """The published floating-point operations of one prediction, millions; None for `xgb`.

    Raises:
        SettingsError: the paper gives none.
    """
    return None if family == "xgb" else float(_of_inference("mflops", family, combination))


def _of_inference(table: str, family: str, combination: int) -> float:
    try:
        figure: float = _tables()[table][family][str(combination)]
    except KeyError:
        raise SettingsError(f"no published {table} for {family}, inputs {combination}") from None
    return figure
