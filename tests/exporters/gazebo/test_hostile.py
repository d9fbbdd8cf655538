"""Damaged and hostile files are refused, by the layer's name, and nothing is written."""

import base64
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from taxel.errors import ArtifactError
from taxel_exporters.gazebo import document, layers
from taxel_exporters.gazebo.importer import import_network

Change = Callable[[Any], None]


def refuse(path: Path, match: str) -> None:
    repository = path.parent / "repository"
    with pytest.raises(ArtifactError, match=match) as caught:
        import_network(path, repository, name="finger")
    assert len(str(caught.value)) < 600
    assert not repository.exists()


def floats(*values: float) -> str:
    return base64.b64encode(np.array(values, "<f4").tobytes()).decode()


def set_in(keys: tuple[Any, ...], value: Any) -> Change:
    def change(model: Any) -> None:
        place = model.content
        for key in keys[:-1]:
            place = place[key]
        place[keys[-1]] = value

    return change


def set_layer(name: str, key: str, value: Any) -> Change:
    return lambda model: model.layer(name).__setitem__(key, value)


def set_config(name: str, key: str, value: Any) -> Change:
    return lambda model: model.layer(name)["config"].__setitem__(key, value)


def set_inbound(name: str, *sources: str) -> Change:
    return set_layer(name, "inbound_nodes", [[[source, 0, 0, {}] for source in sources]])


def set_weights(name: str, place: int, value: Any) -> Change:
    return lambda model: model.weights(name).__setitem__(place, value)


def set_row(name: str, row: int, value: Any) -> Change:
    return lambda model: model.weights(name)[0].__setitem__(row, value)


def drop_last_row(name: str) -> Change:
    return lambda model: model.weights(name)[0].pop()


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
    "a layer that is none": (set_in(("layers", "layers", 3), "Dense"), "layer 4 of the list"),
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

WEIGHTS: dict[str, tuple[Change, str]] = {
    "no array": (lambda model: model.weights("trunk_in").clear(), "layer 'trunk_in': 0 arrays"),
    "no bias": (lambda model: model.weights("trunk_in").pop(), "layer 'trunk_in': 1 arrays"),
    "a bias too many": (
        lambda model: model.weights("warm_pick").append(floats(1)),
        "layer 'warm_pick': 2 arrays",
    ),
    "arrays of a sum": (lambda model: model.weights("sum").append(floats(1)), "layer 'sum': 1 arrays"),
    "no list of arrays": (
        lambda model: set_in(("weights", model.position("sum")), "none")(model),
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

FRAME: dict[str, tuple[Change, str]] = {
    "no weights": (lambda model: model.content.pop("weights"), "weights: Field required"),
    "no layers": (set_in(("layers", "layers"), []), "layers: layers: List should have at least 1"),
    "too many layers": (
        set_in(("layers", "layers"), [{}] * 513),
        "layers: layers: List should have at most 512",
    ),
    "two outputs": (
        set_in(("layers", "output_layers"), [["sum", 0, 0], ["warm_out", 0, 0]]),
        "layers: output_layers",
    ),
    "unknown output": (
        set_in(("layers", "output_layers"), [["end", 0, 0]]),
        "output layer 'end': not among",
    ),
    "narrow output": (
        set_in(("layers", "output_layers"), [["trunk_in", 0, 0]]),
        "output layer 'trunk_in': gives 9 values: expected 23",
    ),
    "input that is none": (set_in(("layers", "input_layers"), [["sum", 0, 0]]), "input layer 'sum'"),
    "short mean": (
        lambda model: model.content["normalization"]["input"]["center"].pop(),
        "normalization: input.center",
    ),
    "a thousand faults": (
        set_in(("normalization", "input", "center"), ["x"] * 1000),
        "normalization: input.center",
    ),
    "deviation of zero": (
        set_in(("normalization", "output", "scale", 4), 0.0),
        "normalization: output.scale.4",
    ),
    "mean not finite": (
        set_in(("normalization", "input", "center", 2), float("nan")),
        "normalization: input.center.2",
    ),
}


@pytest.mark.parametrize("damage", LAYERS)
def test_layers_outside_the_format(model: Any, tmp_path: Path, damage: str) -> None:
    change, match = LAYERS[damage]
    change(model)
    refuse(model.write(tmp_path), match)


def test_weights_that_overflow(model: Any, tmp_path: Path) -> None:
    for name in ("place_out", "touch_out"):
        matrix = model.arrays[name][0] * np.float32(1e16)
        model.weights(name)[0] = [floats(*row) for row in matrix]
    with pytest.raises(ArtifactError, match="layer 'product': its values overflow"):
        import_network(model.write(tmp_path), tmp_path / "repository", name="finger")
    assert list((tmp_path / "repository").iterdir()) == []


@pytest.mark.parametrize("damage", WEIGHTS)
def test_damaged_weights(model: Any, tmp_path: Path, damage: str) -> None:
    change, match = WEIGHTS[damage]
    change(model)
    refuse(model.write(tmp_path), match)


@pytest.mark.parametrize("damage", FRAME)
def test_a_damaged_frame(model: Any, tmp_path: Path, damage: str) -> None:
    change, match = FRAME[damage]
    change(model)
    refuse(model.write(tmp_path), match)


def test_no_input_layer(model: Any, tmp_path: Path) -> None:
    for listed in (model.content["layers"]["layers"], model.content["weights"]):
        del listed[0]
    refuse(model.write(tmp_path), "layer 'place_pick': takes 'Input'")


def test_two_input_layers(model: Any, tmp_path: Path) -> None:
    model.content["layers"]["layers"].insert(1, {**model.layer("Input"), "name": "Other"})
    model.content["weights"].insert(1, [])
    refuse(model.write(tmp_path), "layer 'Other': a second InputLayer")


@pytest.mark.parametrize(("limit", "layer"), [("MAX_PARAMETERS", "touch_pick"), ("MAX_WIDTH", "sum")])
def test_sizes_are_limited_in_sum(
    model: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, limit: str, layer: str
) -> None:
    monkeypatch.setattr(layers, limit, 120)
    refuse(model.write(tmp_path), f"layer '{layer}': expected at most 120")


@pytest.fixture(params=["CSafeLoader", "SafeLoader"])
def parser(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Either of PyYAML's parsers."""
    monkeypatch.setattr(document, "_LOADER", getattr(yaml, request.param))


PLACES = {
    "activation: sigmoid": "layer 'warm_in': ",
    "name: model_1": "",
}


@pytest.mark.usefixtures("parser")
@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize(
    "tag",
    [
        "!!python/object/apply:os.system",
        "!!python/object/new:subprocess.Popen",
        "!!python/name:os.system",
        "!!python/module:antigravity",
        "!!python/object:taxel.errors.TaxelError",
        "!!timestamp",
        "!mine",
        "!<tag:yaml.org,2002:python/object/apply:os.system>",
    ],
)
def test_no_tag_makes_an_object(model: Any, tmp_path: Path, place: str, tag: str) -> None:
    key = place.split(":")[0]
    text = model.text()
    assert text.count(place) == 1
    for value in (f"{tag} ['touch {tmp_path}/executed']", f"{tag} 'touch {tmp_path}/executed'"):
        path = tmp_path / "model.yaml"
        path.write_text(text.replace(place, f"{key}: {value}"))
        refuse(path, rf"line \d+: {PLACES[place]}tag '(tag:yaml.org,2002:|!)[^']*' is refused")
    assert not (tmp_path / "executed").exists()


@pytest.mark.usefixtures("parser")
def test_a_tag_in_the_weights_names_their_layer(model: Any, tmp_path: Path) -> None:
    """Also where the layers come later in the file than their weights."""
    model.weights("trunk_in")[1] = "HERE"
    content = yaml.dump({"weights": model.content["weights"]}) + yaml.dump(
        {key: model.content[key] for key in ("layers", "normalization")}
    )
    path = tmp_path / "model.yaml"
    path.write_text(content.replace("HERE", "!!python/name:os.system ''"))
    refuse(path, "layer 'trunk_in': tag")


BOMB = "\n".join(
    ["a0: &a0 [x, x, x, x, x, x, x, x, x, x]"]
    + [f"a{level}: &a{level} [{', '.join([f'*a{level - 1}'] * 10)}]" for level in range(1, 12)]
)

TEXTS: dict[str, tuple[str, str]] = {
    "empty": ("", "empty"),
    "a list": ("[1, 2]", "valid dictionary"),
    "a text": ("hello", "valid dictionary"),
    "not YAML": ("layers: [1, 2", "line [12]: not YAML"),
    "a control character": ("layers: \x00", "not YAML"),
    "two documents": ("layers: {}\n---\nlayers: {}", "line 2: a second document"),
    "a bomb of aliases": (BOMB, "line 6: expected at most 1000000 values"),
    "an alias of itself": ("layers: &a [*a]", "alias 'a' of nothing that ended"),
    "an alias of nothing": ("layers: *b", "alias 'b' of nothing|undefined alias"),
    "a deep list": ("layers: " + "[" * 100_000, "expected at most 32 lists"),
    "a deep mapping": ("layers:\n" + "".join(f"{' ' * depth}k:\n" for depth in range(1, 60)), "at most 32"),
    "a key twice": ("layers: {}\nweights: []\nlayers: {}", "line 3: the key 'layers' stands twice"),
    "a list as key": ("? [a]\n: b", "a key that is no text"),
}


@pytest.mark.usefixtures("parser")
@pytest.mark.parametrize("kind", TEXTS)
def test_hostile_documents(tmp_path: Path, kind: str) -> None:
    text, match = TEXTS[kind]
    path = tmp_path / "model.yaml"
    path.write_text(text)
    refuse(path, match)


def test_values_are_limited(model: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(document, "MAX_VALUES", 300)
    refuse(model.write(tmp_path), r"line \d+: layer \d+ of the list: expected at most 300 values")


def test_a_key_twice_names_the_layer(model: Any, tmp_path: Path) -> None:
    path = tmp_path / "model.yaml"
    path.write_text(
        model.text().replace("activation: sigmoid", "activation: sigmoid\n      activation: relu")
    )
    refuse(path, "layer 'warm_in': the key 'activation' stands twice")


def test_files_that_cannot_be_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    refuse(tmp_path / "nowhere.yaml", "No such file")
    (tmp_path / "folder").mkdir()
    refuse(tmp_path / "folder", "Is a directory")
    (tmp_path / "latin.yaml").write_bytes(b"layers: \xff\xfe")
    refuse(tmp_path / "latin.yaml", "not YAML")
    monkeypatch.setattr(document, "MAX_BYTES", 1 << 20)
    (tmp_path / "large.yaml").write_bytes(bytes((1 << 20) + 1))
    refuse(tmp_path / "large.yaml", "expected at most 1 MiB")
