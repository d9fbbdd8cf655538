"""A network of the plugin predicts, once imported and served, what its file defines."""

import base64
import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
import typer
import yaml
from pydantic import ValidationError
from typer.testing import CliRunner, Result

import taxel
from taxel import artifacts
from taxel.channels import CHANNELS
from taxel.corrections import AppliedEffect, Weighted
from taxel.errors import ArtifactError, SettingsError
from taxel.manifest import Manifest
from taxel.windows import ExtraFeature
from taxel_exporters.commands import export
from taxel_exporters.corrected import export_corrected
from taxel_exporters.gazebo import importer
from taxel_exporters.gazebo.importer import import_network
from taxel_exporters.onnx_file import IR_VERSION, OPSET

TOLERANCE = 0.05


def served(repository: Path, windows: np.ndarray) -> np.ndarray:
    with taxel.load(repository) as source:
        return source.predictor("finger").predict(windows)


def in_our_order(columns: dict[str, np.ndarray]) -> np.ndarray:
    return np.hstack([columns[name] for name in ("position", "force", "last", "next")])


def test_it_predicts_what_the_file_defines(model: Any, draw: Callable, tmp_path: Path) -> None:
    import_network(model.write(tmp_path), tmp_path / "repository", name="finger")
    columns = draw(model, 500)
    windows = in_our_order(columns)
    with_temperature = np.column_stack([windows, columns["tdc"]])
    expected = model.predict(columns)
    np.testing.assert_allclose(served(tmp_path / "repository", with_temperature), expected, atol=TOLERANCE)
    columns["tdc"] = np.full(500, 1968.75)
    at_mean = model.predict(columns)
    np.testing.assert_allclose(served(tmp_path / "repository", windows), at_mean, atol=TOLERANCE)
    assert np.abs(at_mean - expected).max() > 10


def test_effects_take_the_temperature_that_the_model_takes(
    model: Any, draw: Callable, tmp_path: Path
) -> None:
    repository = tmp_path / "repository"
    import_network(model.write(tmp_path), repository, name="finger")
    columns = draw(model, 50)
    windows = np.column_stack([in_our_order(columns), columns["tdc"], columns["tdc"]])
    before = served(repository, windows[:, :-1])
    term = Weighted(shape="unit", features=("tdc",), references=(1900.0,), weights=((0.5,) * 21,))
    effect = AppliedEffect(name="temperature", about="Follows tdc.", channels=CHANNELS, terms=(term,))
    heat = ExtraFeature(name="tdc", unit="counts", default=1900.0, taken_by="effects")
    export_corrected(repository, "finger", "1", [effect], [heat], windows=windows)
    expected = before + 0.5 * (columns["tdc"][:, None] - 1900)
    np.testing.assert_allclose(served(repository, windows[:, :-1]), expected, atol=0.01)


def test_future_and_past_are_those_of_the_training(model: Any, draw: Callable, tmp_path: Path) -> None:
    """From samples over time: the network's seventh input is the force 100 ms ahead."""
    import_network(model.write(tmp_path), tmp_path / "repository", name="finger")
    columns = draw(model, 60)
    samples = taxel.Samples.of(np.arange(60) * 10_000_000, columns["position"], columns["force"])
    with taxel.load(tmp_path / "repository") as source:
        predictor = source.predictor("finger")
        found = predictor.predict(taxel.build_windows(samples, predictor.window).values)
    force, rows = columns["force"], np.arange(10, 50)
    named = {"position": columns["position"][rows], "force": force[rows], "tdc": np.full(40, 1968.75)}
    right = model.predict({**named, "next": force[rows + 10], "last": force[rows - 10]})
    swapped = model.predict({**named, "next": force[rows - 10], "last": force[rows + 10]})
    np.testing.assert_allclose(found, right, atol=TOLERANCE)
    assert np.abs(found - swapped).max() > 10


def test_the_manifest_says_what_it_is(model: Any, tmp_path: Path) -> None:
    path = model.write(tmp_path)
    manifest = import_network(path, tmp_path / "repository", name="finger")
    folder = tmp_path / "repository" / "finger" / "1"
    assert artifacts.read(folder).manifest == manifest
    assert {file.name for file in folder.iterdir()} == {"model.onnx", "manifest.json", "README.md"}
    assert [file.name for file in (tmp_path / "repository").iterdir()] == ["finger"]
    (extra,) = manifest.window.extras
    assert (extra.name, extra.unit, extra.default) == ("tdc", "counts", 1968.75)
    assert manifest.window.features[-4:] == ("fx[+10]", "fy[+10]", "fz[+10]", "tdc")
    center, scale = (values.tolist() for values in model.statistics["input"])
    assert list(manifest.normalisation.input_mean) == center[:6] + center[9:12] + center[6:9] + center[12:]
    assert list(manifest.normalisation.input_std) == scale[:6] + scale[9:12] + scale[6:9] + scale[12:]
    means = model.statistics["output"][0].tolist()
    assert list(manifest.normalisation.output_mean) == [means[0], means[2], *means[4:]]
    assert manifest.normalisation.folded
    assert manifest.parameters == sum(array.size for arrays in model.arrays.values() for array in arrays)
    assert manifest.training is None
    assert manifest.imported is not None
    assert manifest.imported.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()
    assert manifest.parity is not None
    assert 0 < manifest.parity.largest_difference < manifest.parity.tolerance < 0.2
    card = (folder / "README.md").read_text()
    assert "trained elsewhere" in card
    assert "model.yaml (gazebo-plugin" in card
    written = onnx.load(folder / "model.onnx")
    assert (written.ir_version, written.opset_import[0].version) == (IR_VERSION, OPSET)


def test_a_manifest_says_one_thing_of_its_origin(model: Any, tmp_path: Path) -> None:
    manifest = import_network(model.write(tmp_path), tmp_path / "repository", name="finger")
    content = {**manifest.model_dump(mode="json"), "imported": None}
    with pytest.raises(ValidationError, match="either training or imported"):
        Manifest.model_validate_json(json.dumps(content))


class Tagged(str):
    """A text that is written with a tag."""

    tag = ""


class Python2Dumper(yaml.Dumper):
    """Writes texts with the tags of Python 2."""


Python2Dumper.add_multi_representer(
    Tagged,
    lambda dumper, text: dumper.represent_scalar(text.tag, str(text), style="|" if "\n" in text else None),
)


def tagged(tag: str, text: str) -> Tagged:
    result = Tagged(text)
    result.tag = f"tag:yaml.org,2002:{tag}"
    return result


def every_text(tree: Any, change: Callable[[str], Any]) -> Any:
    if isinstance(tree, list):
        return [every_text(part, change) for part in tree]
    return change(tree)


def in_lines(text: str) -> str:
    return "\n".join(text[start : start + 76] for start in range(0, len(text), 76)) + "\n"


@pytest.mark.parametrize(
    "written_as",
    [
        pytest.param(lambda text: tagged("python/str", text), id="python 2 str"),
        pytest.param(lambda text: tagged("python/unicode", text), id="python 2 unicode"),
        pytest.param(lambda text: tagged("binary", in_lines(text)), id="python 2 bytes"),
        pytest.param(lambda text: text.encode(), id="python 3 bytes of base64"),
        pytest.param(lambda text: base64.b64decode(text), id="python 3 bytes"),
    ],
)
def test_every_way_of_writing_the_weights_gives_the_same(
    model: Any, tmp_path: Path, written_as: Callable[[str], Any]
) -> None:
    import_network(model.write(tmp_path), tmp_path / "repository", name="plain")
    model.content["weights"] = every_text(model.content["weights"], written_as)
    layers = model.content["layers"]["layers"]
    for layer in layers:
        layer["name"] = tagged("python/str", layer["name"])
    path = tmp_path / "tagged.yaml"
    path.write_text(yaml.dump(model.content, Dumper=Python2Dumper))
    assert "!!python/tuple" in path.read_text()
    import_network(path, tmp_path / "repository", name="tagged")
    plain, other = (tmp_path / "repository" / name / "1" / "model.onnx" for name in ("plain", "tagged"))
    assert plain.read_bytes() == other.read_bytes()


def test_an_alias_stands_for_what_it_repeats(model: Any, tmp_path: Path) -> None:
    shared = model.layer("place_in")["config"]["kernel_initializer"]
    model.layer("touch_in")["config"]["kernel_initializer"] = shared
    assert "*id" in model.text()
    assert import_network(model.write(tmp_path), tmp_path / "repository", name="finger").version == "1"


def test_versions_count_up_and_names_are_checked(model: Any, tmp_path: Path) -> None:
    path, repository = model.write(tmp_path), tmp_path / "repository"
    assert [import_network(path, repository, name="finger").version for _ in range(2)] == ["1", "2"]
    with pytest.raises(SettingsError, match="versions do not change"):
        import_network(path, repository, name="finger", version="2")
    with pytest.raises(SettingsError, match="--name"):
        import_network(path, repository, name="../finger")


def run(*arguments: object) -> Result:
    app = typer.Typer()
    app.command()(export)
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


def test_the_command_imports(model: Any, tmp_path: Path) -> None:
    path, repository = model.write(tmp_path), tmp_path / "repository"
    options = ("--from", "gazebo-plugin", path, "--repository", repository)
    result = run(*options, "--name", "finger")
    assert result.exit_code == 0
    assert "Parity on 4096 random windows" in result.stdout
    document = json.loads(run(*options, "--name", "finger", "--json").stdout)
    assert (document["name"], document["version"]) == ("finger", "2")
    assert document["imported"]["format"] == "gazebo-plugin"
    for missing in ((), ("--name", "finger", "--format", "xgboost")):
        assert isinstance(run(*options, *missing).exception, SettingsError)
    assert run(path, "--repository", repository, "--from", "elsewhere").exit_code == 2


def test_an_artifact_that_fails_parity_is_not_written(
    model: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The check evaluates the network on its own, so that a wrong graph is noticed."""
    original = importer.network_onnx

    def with_past_and_future_swapped(network: Any) -> onnx.ModelProto:
        written = original(network)
        gather = written.graph.node[0]
        (order,) = [tensor for tensor in written.graph.initializer if tensor.name == gather.input[1]]
        columns = onnx.numpy_helper.to_array(order).copy()
        columns[6:12] = np.roll(columns[6:12], 3)
        order.CopyFrom(onnx.numpy_helper.from_array(columns, order.name))
        return written

    monkeypatch.setattr(importer, "network_onnx", with_past_and_future_swapped)
    with pytest.raises(ArtifactError, match=r"parity: window \d+, channel \w+: the artifact gives"):
        import_network(model.write(tmp_path), tmp_path / "repository", name="finger")
    assert list((tmp_path / "repository").iterdir()) == []
