"""Artifacts that someone made to do harm: each is refused with its reason, and the others are served."""

import hashlib
import json
import os
from collections.abc import Callable
from pathlib import Path
from queue import SimpleQueue
from typing import Any

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

from taxel import artifacts
from taxel.artifacts import MANIFEST, MOST_MANIFEST_BYTES
from taxel.errors import ArtifactError
from taxel_server.engine import Engine
from taxel_server.loading import loader as loader_module
from taxel_server.loading.exchange import Exchange
from taxel_server.loading.loader import Loader
from taxel_server.loading.trials import Trials
from taxel_server.runtimes.graph_checks import check_graph

ArtifactMaker = Callable[..., Path]

FEATURES = 6
HANG_S = 300


@pytest.fixture
def repository(tmp_path: Path, make_artifact: ArtifactMaker) -> Path:
    """A sound model beside the hostile ones."""
    folder = tmp_path / "repository"
    make_artifact(folder, "skin", "1")
    return folder


def rewrite(folder: Path, change: Callable[[dict[str, Any]], object]) -> None:
    manifest = json.loads((folder / MANIFEST).read_text())
    change(manifest)
    (folder / MANIFEST).write_text(json.dumps(manifest))


def fifo(folder: Path) -> None:
    (folder / MANIFEST).unlink()
    os.mkfifo(folder / MANIFEST)


def fifo_as_model(folder: Path) -> None:
    (folder / "model.json").unlink()
    os.mkfifo(folder / "model.json")


def endless(folder: Path) -> None:
    (folder / MANIFEST).unlink()
    (folder / MANIFEST).symlink_to("/dev/zero")


def file_elsewhere(folder: Path) -> None:
    outside = folder.parents[2] / "outside.json"
    (folder / "model.json").rename(outside)
    (folder / "model.json").symlink_to(outside)


def folder_elsewhere(folder: Path) -> None:
    outside = folder.parents[2] / "outside"
    folder.rename(outside)
    folder.symlink_to(outside)


def circle(folder: Path) -> None:
    (folder / MANIFEST).unlink()
    (folder / MANIFEST).symlink_to(MANIFEST)


def large_manifest(folder: Path) -> None:
    os.truncate(folder / MANIFEST, MOST_MANIFEST_BYTES + 1)


def large_model(folder: Path) -> None:
    """A sparse file: 2 TiB that take no room."""
    os.truncate(folder / "model.json", 2**41)


def long_text(folder: Path) -> None:
    rewrite(folder, lambda manifest: manifest.update(description="x" * 10_001))


def many_features(folder: Path) -> None:
    names = [{"name": f"e{number}", "unit": "1"} for number in range(300)]
    rewrite(folder, lambda manifest: manifest["window"].update(extras=names))


@pytest.mark.parametrize(
    ("harm", "reason"),
    [
        (fifo, "a FIFO: expected an ordinary file"),
        (fifo_as_model, "a FIFO: expected an ordinary file"),
        (endless, "a link to /dev/zero: expected a file inside"),
        (file_elsewhere, "a link to .*: expected a file inside"),
        (folder_elsewhere, "a link to .*: expected a file inside"),
        (circle, "circle|Too many levels"),
        (large_manifest, f"expected at most {MOST_MANIFEST_BYTES}"),
        (large_model, "expected at most|its manifest says"),
        (long_text, "at most 10000 characters"),
        (many_features, "at most 256 items"),
    ],
)
def test_a_hostile_artifact_is_refused_and_harms_no_other(
    repository: Path, make_artifact: ArtifactMaker, harm: Callable[[Path], None], reason: str
) -> None:
    harm(make_artifact(repository, "evil", "1"))
    with pytest.raises(ArtifactError, match=reason) as refused:
        artifacts.read(repository / "evil" / "1")
    engine = Engine(repository)
    assert [loaded.label for loaded in engine.load_all()] == ["skin/1"]
    assert [(model.name, model.state, model.reason) for model in engine.models()] == [
        ("evil", "UNAVAILABLE", str(refused.value)),
        ("skin", "READY", ""),
    ]


def test_links_inside_the_repository_are_followed(repository: Path) -> None:
    """As in a volume of Kubernetes, where each file is a link to a folder beside it."""
    folder = repository / "skin" / "1"
    beside = repository / "..data"
    folder.rename(beside)
    folder.mkdir()
    for file in beside.iterdir():
        (folder / file.name).symlink_to(file)
    assert artifacts.read(folder).manifest.name == "skin"


def onnx_model(*nodes: onnx.NodeProto, **tensors: np.ndarray) -> onnx.ModelProto:
    """A model from `window` (n, 6) to `channels` (n, 21), with weights `w` and further tensors."""
    weights = {"w": np.zeros((FEATURES, 21), np.float32), **tensors}
    graph = helper.make_graph(
        nodes,
        "hostile",
        [helper.make_tensor_value_info("window", TensorProto.FLOAT, ["n", FEATURES])],
        [helper.make_tensor_value_info("channels", TensorProto.FLOAT, ["n", 21])],
        [numpy_helper.from_array(values, name) for name, values in weights.items()],
    )
    return helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=9)


def long_computation() -> onnx.ModelProto:
    """No loop, but hours of products."""
    size = np.array([3000, 3000], np.int64)
    products = [helper.make_node("MatMul", [f"m{at}", f"m{at}"], [f"m{at + 1}"]) for at in range(5000)]
    return onnx_model(
        helper.make_node("ReduceSum", ["window"], ["sum"], keepdims=0),
        helper.make_node("Expand", ["sum", "size"], ["m0"]),
        *products,
        helper.make_node("ReduceMean", [f"m{len(products)}"], ["mean"], keepdims=0),
        helper.make_node("Mul", ["mean", "zero"], ["nothing"]),
        helper.make_node("MatMul", ["window", "w"], ["product"]),
        helper.make_node("Add", ["product", "nothing"], ["channels"]),
        size=size,
        zero=np.array(0, np.float32),
    )


def large_tensor() -> onnx.ModelProto:
    """A few hundred bytes that ask for 64 GiB."""
    return onnx_model(
        helper.make_node("ReduceSum", ["window"], ["sum"], keepdims=0),
        helper.make_node("Expand", ["sum", "size"], ["large"]),
        helper.make_node("ReduceMean", ["large"], ["mean"], keepdims=0),
        helper.make_node("MatMul", ["window", "w"], ["product"]),
        helper.make_node("Add", ["product", "mean"], ["channels"]),
        size=np.array([2**17, 2**17], np.int64),
    )


def sound() -> onnx.ModelProto:
    return onnx_model(helper.make_node("MatMul", ["window", "w"], ["channels"]))


def endless_loop() -> onnx.GraphProto:
    """A graph with a loop whose condition stays true."""
    info = helper.make_tensor_value_info
    body = helper.make_graph(
        [helper.make_node("Identity", ["go"], ["on"]), helper.make_node("Identity", ["x"], ["y"])],
        "body",
        [
            info("i", TensorProto.INT64, []),
            info("go", TensorProto.BOOL, []),
            info("x", TensorProto.FLOAT, None),
        ],
        [info("on", TensorProto.BOOL, []), info("y", TensorProto.FLOAT, None)],
    )
    loop = helper.make_node("Loop", ["", "true", "window"], ["result"], name="forever", body=body)
    return helper.make_graph([loop], "outer", [], [info("result", TensorProto.FLOAT, None)])


@pytest.mark.parametrize("inside", [False, True])
def test_a_loop_is_refused_before_it_runs(tmp_path: Path, inside: bool) -> None:
    """Also one that hides in a branch."""
    graph = endless_loop()
    branch = helper.make_node("If", ["true"], ["result"], then_branch=graph, else_branch=graph)
    last = helper.make_node("MatMul", ["result", "w"], ["channels"])
    first = branch if inside else graph.node[0]
    onnx.save(onnx_model(first, last, true=np.array(True)), tmp_path / "model.onnx")
    with pytest.raises(ArtifactError, match="node 'forever' is a Loop: expected no loops"):
        check_graph(tmp_path / "model.onnx")


def test_weights_in_another_file_are_refused_before_they_are_read(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "weights")
    model = sound()
    tensor = model.graph.initializer[0]
    tensor.ClearField("raw_data")
    tensor.data_location = TensorProto.EXTERNAL
    tensor.external_data.add(key="location", value="weights")
    (tmp_path / "model.onnx").write_bytes(model.SerializeToString())
    with pytest.raises(ArtifactError, match="tensor 'w' lies in another file"):
        check_graph(tmp_path / "model.onnx")


def put_onnx(repository: Path, name: str, model: onnx.ModelProto) -> Path:
    """Write a model as the artifact NAME/1, with the manifest of `skin`."""
    content = model.SerializeToString()
    folder = repository / name / "1"
    folder.mkdir(parents=True)
    (folder / "model.onnx").write_bytes(content)
    manifest = json.loads((repository / "skin" / "1" / MANIFEST).read_text())
    manifest |= {"name": name, "platform": "onnxruntime_onnx"}
    manifest["normalisation"]["folded"] = True
    sha256 = hashlib.sha256(content).hexdigest()
    manifest["model_file"] = {"name": "model.onnx", "sha256": sha256, "size": len(content)}
    (folder / MANIFEST).write_text(json.dumps(manifest))
    return folder


def test_trials_end_what_takes_too_long_or_too_much(repository: Path) -> None:
    slow = put_onnx(repository, "slow", long_computation())
    large = put_onnx(repository, "large", large_tensor())
    good = put_onnx(repository, "good", sound())

    def reasons(trials: Trials, *folders: Path) -> dict[Path, str]:
        return {folder: reason for folder, reason in trials.run(folders) if reason is not None}

    assert "took longer than 1 s" in reasons(Trials(1, 4096), slow)[slow]
    found = reasons(Trials(60, 512), large, good)
    assert found[good] == ""
    assert "68719476736" in found[large]


def test_nobody_waits_for_a_model_that_never_answers(
    repository: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(loader_module, "_PATIENCE_S", 0.1)
    put_onnx(repository, "slow", long_computation())
    engine = Engine(repository)
    loader = Loader(engine, Trials(600, 4096))
    loader.start()
    try:
        loader.wait()
        told = {model.name: (model.state, model.reason) for model in engine.models()}
        assert told["skin"] == ("READY", "")
        assert told["slow"][0] == "UNAVAILABLE"
        assert "being tried out" in told["slow"][1]
    finally:
        loader.close()


def test_a_version_that_never_ends_is_refused_while_others_are_loaded(repository: Path) -> None:
    """While a server runs: the endless one in its process takes nothing from the sound one."""
    put_onnx(repository, "slow", long_computation())
    put_onnx(repository, "large", large_tensor())
    put_onnx(repository, "good", sound())
    engine = Engine(repository)
    engine.hold([("slow", "1"), ("large", "1"), ("good", "1")], "not yet")
    exchange = Exchange(engine, Trials(1, 1024))
    told: SimpleQueue[tuple[str, str]] = SimpleQueue()
    for name in ("slow", "large", "good"):
        exchange.load((name, "1"), lambda refusal, name=name: told.put((name, str(refusal or ""))))
    reasons = dict(told.get(timeout=HANG_S) for _ in range(3))
    exchange.close()
    assert reasons["good"] == ""
    assert "took longer than 1 s" in reasons["slow"]
    assert "68719476736" in reasons["large"]
    states = {model.name: model.state for model in engine.models()}
    assert states == {"good": "READY", "large": "UNAVAILABLE", "skin": "READY", "slow": "UNAVAILABLE"}
