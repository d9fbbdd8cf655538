"""Layers outside the format are refused, by name."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from taxel_exporters.gazebo import layers

Change = Callable[[Any], None]
Refusal = Callable[[Path], str]


def set_layer(name: str, key: str, value: Any) -> Change:
    return lambda model: model.layer(name).__setitem__(key, value)


def set_config(name: str, key: str, value: Any) -> Change:
    return lambda model: model.layer(name)["config"].__setitem__(key, value)


def set_inbound(name: str, *sources: str) -> Change:
    return set_layer(name, "inbound_nodes", [[[source, 0, 0, {}] for source in sources]])


def move_to_end(name: str) -> Change:
    def change(model: Any) -> None:
        position = model.position(name)
        for listed in (model.content["layers"]["layers"], model.content["weights"]):
            listed.append(listed.pop(position))

    return change


LAYERS: dict[str, tuple[Change, str]] = {
    "unknown class": (set_layer("trunk_in", "class_name", "Lambda"), "layer 'trunk_in': class_name"),
    "unknown activation": (
        set_config("trunk_in", "activation", "tanh"),
        "layer 'trunk_in': config: activation",
    ),
    "no config": (lambda model: model.layer("sum").pop("config"), "layer 'sum': config: Field required"),
    "no bias flag": (
        lambda model: model.layer("warm_in")["config"].pop("use_bias"),
        "'warm_in': config: use_bias",
    ),
    "no name": (lambda model: model.layer("sum").pop("name"), "layer 14 of the list: name"),
    "name of a list": (set_layer("sum", "name", ["sum"]), "layer 14 of the list: name"),
    "endless name": (set_layer("sum", "name", "s" * 5000), "layer 's{60}…': name"),
    "a layer that is none": (
        lambda model: model.content["layers"]["layers"].__setitem__(3, "Dense"),
        "layer 4 of the list",
    ),
    "same name twice": (set_layer("trunk_out", "name", "warm_out"), "layer 'warm_out': a layer before it"),
    "second input": (
        set_layer("place_pick", "class_name", "InputLayer"),
        "layer 'place_pick': 1 inbound layers: expected 0",
    ),
    "other input width": (
        set_config("Input", "batch_input_shape", [None, 12]),
        "layer 'Input': config: batch_input_shape",
    ),
    "zero units": (set_config("trunk_in", "units", 0), "layer 'trunk_in': config: units"),
    "units that are none": (set_config("trunk_in", "units", "many"), "layer 'trunk_in': config: units"),
    "huge units": (set_config("trunk_in", "units", 10**9), "layer 'trunk_in': config: units"),
    "too many parameters": (set_config("trunk_in", "units", 60_000), "layer 'trunk_in': weights, row 1"),
    "takes nothing": (set_layer("trunk_in", "inbound_nodes", []), "layer 'trunk_in': 0 inbound layers"),
    "takes two": (set_inbound("trunk_in", "product", "product"), "layer 'trunk_in': 2 inbound layers"),
    "takes what is not there": (set_inbound("trunk_in", "nowhere"), "layer 'trunk_in': takes 'nowhere'"),
    "takes itself": (set_inbound("trunk_in", "trunk_in"), "layer 'trunk_in': takes 'trunk_in'"),
    "a cycle": (set_inbound("place_in", "place_out"), "layer 'place_in': takes 'place_out'"),
    "wrong order": (move_to_end("product"), "layer 'trunk_in': takes 'product'"),
    "adds one": (set_inbound("sum", "warm_out"), "layer 'sum': 1 inbound layers: expected at least 2"),
    "adds unequal widths": (
        set_inbound("sum", "warm_out", "trunk_in"),
        "layer 'sum': takes layers of .23, 9.",
    ),
    "used twice": (
        set_layer("trunk_in", "inbound_nodes", [[["product", 0, 0]], [["product", 0, 0]]]),
        "layer 'trunk_in': inbound_nodes",
    ),
    "another node of a layer": (
        set_layer("trunk_in", "inbound_nodes", [[["product", 1, 0]]]),
        "layer 'trunk_in': inbound_nodes",
    ),
    "empty inbound": (set_layer("trunk_in", "inbound_nodes", [[[]]]), "layer 'trunk_in': inbound_nodes"),
}


@pytest.mark.parametrize("damage", LAYERS)
def test_layers_outside_the_format(model: Any, tmp_path: Path, damage: str, refusal: Refusal) -> None:
    change, match = LAYERS[damage]
    change(model)
    assert re.search(match, refusal(model.write(tmp_path)))


def test_no_input_layer(model: Any, tmp_path: Path, refusal: Refusal) -> None:
    for listed in (model.content["layers"]["layers"], model.content["weights"]):
        del listed[0]
    assert re.search("layer 'place_pick': takes 'Input'", refusal(model.write(tmp_path)))


def test_two_input_layers(model: Any, tmp_path: Path, refusal: Refusal) -> None:
    model.content["layers"]["layers"].insert(1, {**model.layer("Input"), "name": "Other"})
    model.content["weights"].insert(1, [])
    assert re.search("layer 'Other': a second InputLayer", refusal(model.write(tmp_path)))


@pytest.mark.parametrize(("limit", "layer"), [("MAX_PARAMETERS", "touch_pick"), ("MAX_WIDTH", "sum")])
def test_sizes_are_limited_in_sum(
    model: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, limit: str, layer: str, refusal: Refusal
) -> None:
    monkeypatch.setattr(layers, limit, 120)
    assert re.search(f"layer '{layer}': expected at most 120", refusal(model.write(tmp_path)))
