"""The paper's figures, shown beside ours if the data are the paper's."""

import json
from collections.abc import Sequence
from functools import cache
from importlib.resources import files
from typing import Any, Final

from taxel_models.recordings import Recording

ROWS: Final = 292_200
"""Rows of the data set of Ruppel et al. 2018."""

TDC_SUM: Final = 575_268_794
"""The sum of its temperature column: the published mean, 1968.7501505817934 counts, times its rows."""


def is_published_data(recordings: Sequence[Recording]) -> bool:
    """Whether this is the paper's data set: its number of rows and its mean temperature agree."""
    if len(recordings) != 1 or len(recordings[0]) != ROWS:
        return False
    return bool(recordings[0].auxiliary["tdc"].sum() == TDC_SUM)


def published_result(model: str, combination: int) -> dict[str, Any] | None:
    """Parameters, errors and their standard deviations over ten folds; None if there are none."""
    result: dict[str, Any] | None = _tables()["results"].get(model, {}).get(str(combination))
    return result


def published_windows(model: str, comparison: str) -> dict[str, float] | None:
    """The test of two input combinations, such as `1 vs 2`; None if there is none."""
    found: dict[str, float] | None = _tables()["windows"].get(model, {}).get(comparison)
    return found


def published_models(combination: int, comparison: str) -> dict[str, float] | None:
    """The test of two models, such as `xgb vs network-b`; None if there is none."""
    found: dict[str, float] | None = _tables()["models"].get(str(combination), {}).get(comparison)
    return found


def published_temperature() -> dict[str, float]:
    """Network B's normalised MAE, inputs 1, by its given temperature, and the relative loss.

    `measured`, `mean`, `best` (the fixed one with the lowest error), `mean_predictor`, and
    `relative_loss` of `best`.
    """
    found: dict[str, float] = _tables()["temperature"]
    return found


@cache
def _tables() -> dict[str, Any]:
    text = (files("taxel_models.study") / "published.json").read_text(encoding="utf-8")
    tables: dict[str, Any] = json.loads(text)
    return tables
