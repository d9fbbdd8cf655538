"""Weights that are damaged or do not fit their layer are refused, by the layer's name."""

import base64
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from taxel.errors import ArtifactError
from taxel_exporters.gazebo.importer import import_network

Change = Callable[[Any], None]
Refusal = Callable[[Path], str]


def floats(*values: float) -> str:
    return base64.b64encode(np.array(values, "<f4").tobytes()).decode()


def set_weights(name: str, place: int, value: Any) -> Change:
    return lambda model: model.weights(name).__setitem__(place, value)


def set_row(name: str, row: int, value: Any) -> Change:
    return lambda model: model.weights(name)[0].__setitem__(row, value)


def drop_last_row(name: str) -> Change:
    return lambda model: model.weights(name)[0].pop()


WEIGHTS: dict[str, tuple[Change, str]] = {
    "no array": (lambda model: model.weights("trunk_in").clear(), "layer 'trunk_in': 0 arrays"),
    "no bias": (lambda model: model.weights("trunk_in").pop(), "layer 'trunk_in': 1 arrays"),
    "a bias too many": (
        lambda model: model.weights("warm_pick").append(floats(1)),
        "layer 'warm_pick': 2 arrays",
    ),
    "arrays of a sum": (lambda model: model.weights("sum").append(floats(1)), "layer 'sum': 1 arrays"),
    "no list of arrays": (
        lambda model: model.content["weights"].__setitem__(model.position("sum"), "none"),
        "layer 'sum': weights: expected a list",
    ),
    "matrix as a text": (
        set_weights("trunk_in", 0, floats(*range(54))),
        "layer 'trunk_in': weights: expected a matrix",
    ),
    "bias as a matrix": (
        set_weights("trunk_in", 1, [floats(*range(9))]),
        "layer 'trunk_in': bias: expected a base64",
    ),
    "row as a mapping": (set_row("trunk_in", 2, {}), "layer 'trunk_in': weights, row 3: expected a base64"),
    "a row short": (drop_last_row("trunk_in"), "layer 'trunk_in': weights: 5 rows: expected 6"),
    "a short row": (
        set_row("trunk_in", 5, floats(1, 2)),
        "layer 'trunk_in': weights, row 6: 12 characters",
    ),
    "a long bias": (
        set_weights("trunk_in", 1, floats(*range(11))),
        "layer 'trunk_in': bias: 60 characters",
    ),
    "a byte short": (
        set_weights("trunk_in", 1, base64.b64encode(bytes(35)).decode()),
        "layer 'trunk_in': bias: 35 bytes: expected 36",
    ),
    "no base64": (set_row("trunk_in", 0, "*" * 48), "layer 'trunk_in': weights, row 1: damaged base64"),
    "no ascii": (set_row("trunk_in", 0, "ä" * 48), "layer 'trunk_in': weights, row 1: damaged base64"),
    "inner base64 damaged": (
        set_row("trunk_in", 0, base64.b64encode(b"*" * 48).decode()),
        "layer 'trunk_in': weights, row 1: damaged base64",
    ),
    "not a number": (
        set_row("warm_in", 0, floats(1, np.nan, 1, 1, 1)),
        "layer 'warm_in': weights, row 1: .*finite",
    ),
    "infinite": (set_weights("warm_in", 1, floats(1, np.inf, 1, 1, 1)), "layer 'warm_in': bias: .*finite"),
    "a layer's missing": (lambda model: model.content["weights"].pop(), "weights of 13 layers for 14"),
}


@pytest.mark.parametrize("damage", WEIGHTS)
def test_damaged_weights(model: Any, tmp_path: Path, damage: str, refusal: Refusal) -> None:
    change, match = WEIGHTS[damage]
    change(model)
    assert re.search(match, refusal(model.write(tmp_path)))


def test_weights_that_overflow(model: Any, tmp_path: Path) -> None:
    for name in ("place_out", "touch_out"):
        matrix = model.arrays[name][0] * np.float32(1e16)
        model.weights(name)[0] = [floats(*row) for row in matrix]
    with pytest.raises(ArtifactError, match="layer 'product': its values overflow"):
        import_network(model.write(tmp_path), tmp_path / "repository", name="finger")
    assert list((tmp_path / "repository").iterdir()) == []
