"""Texts that are no plain YAML, or far too much of it, are refused before anything is made of them."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

from taxel_exporters.gazebo import document

Refusal = Callable[[Path], str]


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
def test_no_tag_makes_an_object(model: Any, tmp_path: Path, place: str, tag: str, refusal: Refusal) -> None:
    key = place.split(":")[0]
    text = model.text()
    assert text.count(place) == 1
    for value in (f"{tag} ['touch {tmp_path}/executed']", f"{tag} 'touch {tmp_path}/executed'"):
        path = tmp_path / "model.yaml"
        path.write_text(text.replace(place, f"{key}: {value}"))
        assert re.search(
            rf"line \d+: {PLACES[place]}tag '(tag:yaml.org,2002:|!)[^']*' is refused", refusal(path)
        )
    assert not (tmp_path / "executed").exists()


@pytest.mark.usefixtures("parser")
def test_a_tag_in_the_weights_names_their_layer(model: Any, tmp_path: Path, refusal: Refusal) -> None:
    """Also where the layers come later in the file than their weights."""
    model.weights("trunk_in")[1] = "HERE"
    content = yaml.dump({"weights": model.content["weights"]}) + yaml.dump(
        {key: model.content[key] for key in ("layers", "normalization")}
    )
    path = tmp_path / "model.yaml"
    path.write_text(content.replace("HERE", "!!python/name:os.system ''"))
    assert re.search("layer 'trunk_in': tag", refusal(path))


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
def test_hostile_documents(tmp_path: Path, kind: str, refusal: Refusal) -> None:
    text, match = TEXTS[kind]
    path = tmp_path / "model.yaml"
    path.write_text(text)
    assert re.search(match, refusal(path))


def test_values_are_limited(
    model: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, refusal: Refusal
) -> None:
    monkeypatch.setattr(document, "MAX_VALUES", 300)
    assert re.search(
        r"line \d+: layer \d+ of the list: expected at most 300 values", refusal(model.write(tmp_path))
    )


def test_a_key_twice_names_the_layer(model: Any, tmp_path: Path, refusal: Refusal) -> None:
    path = tmp_path / "model.yaml"
    path.write_text(
        model.text().replace("activation: sigmoid", "activation: sigmoid\n      activation: relu")
    )
    assert re.search("layer 'warm_in': the key 'activation' stands twice", refusal(path))


def test_files_that_cannot_be_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, refusal: Refusal
) -> None:
    assert re.search("No such file", refusal(tmp_path / "nowhere.yaml"))
    (tmp_path / "folder").mkdir()
    assert re.search("Is a directory", refusal(tmp_path / "folder"))
    (tmp_path / "latin.yaml").write_bytes(b"layers: \xff\xfe")
    assert re.search("not YAML", refusal(tmp_path / "latin.yaml"))
    monkeypatch.setattr(document, "MAX_BYTES", 1 << 20)
    (tmp_path / "large.yaml").write_bytes(bytes((1 << 20) + 1))
    assert re.search("expected at most 1 MiB", refusal(tmp_path / "large.yaml"))
