"""Other libraries beside ours: the same answers, a result each, and who is missing told by name."""

import json
import re
import shutil
import sys
import time
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import onnx.reference
import pytest
from numpy.typing import NDArray
from typer.testing import CliRunner, Result

from taxel.artifacts import folder_of, read
from taxel.errors import Unavailable
from taxel_bench.commands import app
from taxel_bench.environments import environment, own_versions
from taxel_bench.paper_size import write_paper_sized
from taxel_bench.peers.compiled_treelite import compiled_library
from taxel_bench.peers.networks import GRAPH_PEERS
from taxel_bench.peers.numpy_graph import NumpyGraph
from taxel_bench.peers.peer import GraphModel, Peer, packages_of
from taxel_bench.peers.selection import PeerChoice, open_peers
from taxel_bench.run.protocols import DISTINCT_INPUTS, Effort, run_serving
from taxel_bench.subjects.subject import open_subject
from taxel_bench.windows import random_windows
from taxel_exporters.export import export
from taxel_models.shipped import shipped_repository

Windows = NDArray[np.float32]
QUICK = ("--repetitions", "4", "--seconds", "0.1")
HERE = {
    "xgb": ("xgboost-merged", "onnxruntime"),
    "ffnn": ("onnxruntime", "onnxruntime-int8", "onnxruntime-int8-dynamic", "numpy"),
}
"""Peers that need no environment of their own."""


pytestmark = pytest.mark.usefixtures("empty_cache")


def bench(*arguments: str | Path, code: int = 0) -> Result:
    done = CliRunner().invoke(app, ["run", *map(str, arguments)], env={"COLUMNS": "200"})
    assert done.exit_code == code, done.output
    return done


@pytest.mark.parametrize("model", HERE)
def test_each_peer_has_a_result_and_ours_compares_with_it(model: str) -> None:
    arguments = ("--model", model, "--peers", ",".join(HERE[model]), "--batch", "1,8", *QUICK, "--json")
    said = json.loads(bench(*arguments).stdout)
    assert said["skipped"] == []
    engines = ["paper", *HERE[model], "taxel"]
    for batch in (1, 8):
        results = [each for each in said["results"] if each["batch"] == batch]
        ours = results[-1]
        assert [each["engine"] for each in results] == engines
        assert (ours["too_slow"], ours["too_slow_limit_ms"], ours["left_out"]) == ({}, None, {})
        assert ours["ratios"]["paper"] == ours["ratio"]
        peers = {each["engine"]: each for each in results[1:-1]}
        for name, peer in peers.items():
            assert peer["threads"] == 1
            assert peer["rounded"] == ("int8" in name)
            assert ours["ratios"][name] == pytest.approx(peer["median_ms"] / ours["median_ms"])
            assert ours["cpu_ratios"][name] == pytest.approx(peer["cpu_median_ms"] / ours["cpu_median_ms"])
            assert ours["warm_ratios"][name] == pytest.approx(
                peer["warm_median_ms"] / ours["warm_median_ms"]
            )
        same_answers = [each for each in results[:-1] if not each.get("rounded")]
        assert ours["best_peer"] == min(same_answers, key=lambda each: each["median_ms"])["engine"]
        assert (
            ours["best_warm_peer"] == min(same_answers, key=lambda each: each["warm_median_ms"])["engine"]
        )
        assert ours["evaluator"]


def test_peers_give_the_answers_that_they_promise() -> None:
    """A merged booster to the bit; other orders of sums to rounding; 8 bits to what they cost."""
    for model, names in HERE.items():
        with open_subject(model, peers=PeerChoice(names)) as subject:
            assert [peer.name for peer in subject.peers] == list(names)
            windows = random_windows(subject.manifest, 16, seed=2)
            ours = subject.taxel.predict(windows)
            std = np.asarray(subject.manifest.normalisation.output_std)
            for peer in subject.peers:
                apart = float((np.abs(peer.predict(windows) - ours) / std).max())
                if peer.name == "xgboost-merged":
                    assert apart == 0
                elif "int8" in peer.name:
                    assert 1e-4 < apart < 1
                else:
                    assert apart < 1e-4


def test_a_peer_that_disagrees_or_fails_is_left_out_and_the_others_are_timed() -> None:
    """The answer to the last of all inputs alone is another: the first one was asked for before."""

    def fails(windows: Windows) -> Windows:
        raise MemoryError("no room\nfor so many rows")

    with open_subject("ffnn", peers=PeerChoice(("onnxruntime", "numpy"))) as subject:
        onnx_runtime, numpy = subject.peers
        calls = count()
        wrong = replace(
            onnx_runtime,
            counts=lambda out: onnx_runtime.counts(out) + np.float32(next(calls) == DISTINCT_INPUTS),
        )
        found = {
            name: run_serving(replace(subject, peers=peers), [1], Effort(repetitions=4))
            for name, peers in {
                "wrong": (wrong, numpy),
                "failing": (onnx_runtime, replace(numpy, evaluate=fails)),
            }.items()
        }
    assert [each["engine"] for each in found["wrong"]] == ["paper", "numpy", "taxel"]
    (reason,) = found["wrong"][-1]["left_out"].values()
    # Beside that one count, the two differ in their last bits.
    assert re.search(r"the engine onnxruntime differs from ours by 1(\.00\d*)? counts", reason)
    assert [each["engine"] for each in found["failing"]] == ["paper", "onnxruntime", "taxel"]
    assert found["failing"][-1]["left_out"] == {"numpy": "MemoryError: no room"}


def test_a_peer_whose_calls_take_too_much_of_the_time_is_left_out() -> None:
    with open_subject("ffnn", peers=PeerChoice(("onnxruntime", "numpy"))) as subject:
        onnx_runtime, numpy = subject.peers
        effort = Effort(seconds=4.0)

        def slow(windows: Windows) -> Windows:
            time.sleep(0.11)
            return numpy.evaluate(windows)

        changed = replace(subject, peers=(onnx_runtime, replace(numpy, evaluate=slow)))
        results = run_serving(changed, [64], effort)
    assert [each["engine"] for each in results] == ["paper", "onnxruntime", "taxel"]
    assert results[-1]["too_slow_limit_ms"] == 100
    assert results[-1]["too_slow"]["numpy"] > 100


def test_a_library_that_fails_at_its_first_call_is_skipped() -> None:
    """torch.compile, for one, looks for a compiler only then."""

    def fails(windows: Windows) -> Windows:
        raise RuntimeError("no compiler\nis there")

    artifact = read(folder_of(shipped_repository(), "ffnn"))
    model = GraphModel(artifact, onnx.load(artifact.model_path), None, same_weights=False)
    (works,) = (peer for peer in GRAPH_PEERS if peer.name == "onnxruntime")
    late = Peer[GraphModel]("late", lambda given: replace(works.engine(given), evaluate=fails))
    engines, skipped = open_peers(PeerChoice(None), [late, works], model)
    assert [engine.name for engine in engines] == ["onnxruntime"]
    assert skipped == {"late": "RuntimeError: no compiler"}


def test_peers_that_are_not_there_are_told_by_name() -> None:
    said = json.loads(bench("--model", "xgb", "--peers", "all", *QUICK, "--json").stdout)
    reasons = {each["peer"]: each["reason"] for each in said["skipped"]}
    assert set(reasons) == {"treelite-gtil", "treelite-compiled", "daal4py"}
    assert all("not installed: pass --install to install" in reason for reason in reasons.values())
    assert "scikit-learn-intelex==" in reasons["daal4py"]
    text = bench("--model", "ffnn", "--peers", "openvino,treelite-gtil,numpy", *QUICK).stdout
    assert "skipped openvino: not installed: pass --install to install openvino==" in text
    assert "skipped treelite-gtil: not for this kind of model" in text
    assert "numpy: differs from ours by at most" in text


def test_a_network_that_numpy_does_not_know_is_told() -> None:
    said = json.loads(bench("--model", "transformer", "--peers", "numpy", *QUICK, "--json").stdout)
    ((name, reason),) = [(each["peer"], each["reason"]) for each in said["skipped"]]
    assert name == "numpy"
    assert "its graph has" in reason
    assert "Softmax" in reason


def test_trees_as_onnx_have_peers_though_nothing_published(trained_folder: Path, tmp_path: Path) -> None:
    export(trained_folder, tmp_path, name="finger", model_format="onnx")
    arguments = ("--model", tmp_path / "finger" / "1", "--peers", "onnxruntime", *QUICK, "--json")
    peer, ours = json.loads(bench(*arguments).stdout)["results"]
    assert (peer["engine"], ours["engine"]) == ("onnxruntime", "taxel")
    assert ours["best_peer"] == "onnxruntime"
    assert "ratio" not in ours


@pytest.mark.parametrize("model", ["ffnn", "network-a", "network-b"])
def test_a_graph_by_numpy_is_what_onnx_says_of_it(model: str, tmp_path: Path) -> None:
    graph = onnx.load(write_paper_sized(tmp_path, model, 8, seed=1) / "model.onnx")
    columns = graph.graph.input[0].type.tensor_type.shape.dim[1].dim_value
    windows = np.random.default_rng(0).standard_normal((5, columns)).astype(np.float32)
    expected = onnx.reference.ReferenceEvaluator(graph).run(None, {graph.graph.input[0].name: windows})[0]
    found = NumpyGraph(graph).evaluate(windows)
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-3)


def test_a_product_that_numpy_would_compute_otherwise_is_refused() -> None:
    graph = onnx.load(folder_of(shipped_repository(), "ffnn") / "model.onnx")
    gemm = next(node for node in graph.graph.node if node.op_type == "Gemm")
    (alpha,) = [attribute for attribute in gemm.attribute if attribute.name == "alpha"]
    alpha.f = 0.5
    with pytest.raises(Unavailable, match=r"a Gemm has alpha 0\.5"):
        NumpyGraph(graph)


def test_a_forest_is_compiled_on_request_only(monkeypatch: pytest.MonkeyPatch) -> None:
    artifact = read(folder_of(shipped_repository(), "xgb"))
    monkeypatch.setattr("shutil.which", lambda name: f"/usr/bin/{name}")
    with pytest.raises(Unavailable, match="pass --install"):
        compiled_library(artifact, install=False)
    monkeypatch.setattr("shutil.which", lambda name: None)
    with pytest.raises(Unavailable, match="no gcc"):
        compiled_library(artifact, install=True)


def test_a_forest_that_takes_too_long_to_compile_is_told_with_the_folder_to_remove(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("shutil.which", lambda name: f"/usr/bin/{name}")
    artifact = read(folder_of(shipped_repository(), "xgb"))
    environment("engines/treelite-compiled", [], install=True)
    for limit_s in (0.0, 1200.0):
        with pytest.raises(Unavailable, match=r"longer than 0 s .* remove") as refused:
            compiled_library(artifact, install=True, limit_s=limit_s)
    shutil.rmtree(Path(str(refused.value).rpartition("remove ")[2]))
    # Without TL2cgen it fails now: it was tried again.
    with pytest.raises(Unavailable, match=r"cannot be compiled: .*tl2cgen"):
        compiled_library(artifact, install=True)


def test_a_peers_packages_become_importable_behind_ours(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "path", list(sys.path))
    made = {name: environment(f"engines/{name}", [], install=True) for name in ("works", "fails")}
    for name, interpreter in made.items():
        packages = packages_of(interpreter)
        (packages / f"taxel_{name}.py").write_text(
            "" if name == "works" else "raise ImportError('no luck')"
        )
        (packages / "numpy").mkdir()
        requirements = ["thing==1", *own_versions("numpy", "scipy", "scikit-learn", "onnxruntime")]
        (interpreter.parents[1] / "requirements.json").write_text(json.dumps(requirements))
    works, fails = (
        Peer[GraphModel](name, lambda _: pytest.fail("it is not evaluated"), ("thing==1",), f"taxel_{name}")
        for name in made
    )
    before = list(sys.path)
    with pytest.raises(Unavailable, match="taxel_fails cannot be imported: ImportError: no luck"):
        fails.get_ready(install=False)
    assert sys.path == before
    works.get_ready(install=False)
    assert sys.path == [*before, str(packages_of(made["works"]))]


def test_an_environment_of_another_python_is_told(tmp_path: Path) -> None:
    with pytest.raises(Unavailable, match="was made by another Python: remove it"):
        packages_of(tmp_path / "bin" / "python")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--model", "xgb", "--peers", "catboost"), "no peer 'catboost'"),
        (("--model", "xgb", "--install"), "expected --peers"),
    ],
)
def test_bad_use_is_said(arguments: tuple[str, ...], message: str) -> None:
    assert message in bench(*arguments, code=2).output


def test_a_corrected_model_has_no_peers(corrected: Path) -> None:
    output = bench("--model", corrected, "--peers", "all", *QUICK, code=2).output
    assert "which no peer evaluates" in output


def results_of(*arguments: str) -> list[dict[str, Any]]:
    results: list[dict[str, Any]] = json.loads(bench(*arguments, "--json").stdout)["results"]
    return results


@pytest.mark.skipif(shutil.which("g++") is None, reason="there is no g++: torch.compile needs one")
@pytest.mark.filterwarnings("ignore:.torch.jit:DeprecationWarning")
def test_torch_compiled_gives_the_networks_answers() -> None:
    peer = results_of("--model", "network-b", "--peers", "torch-compiled", *QUICK)[1]
    assert peer["engine"] == "torch-compiled"
    assert 0 <= peer["largest_difference"] < 0.01
