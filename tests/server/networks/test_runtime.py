"""Whole networks: their programs beside ONNX Runtime and beside float64, and which of them is used."""

import logging
from collections.abc import Callable
from pathlib import Path
from threading import Thread
from typing import Any

import numpy as np
import onnx
import onnxruntime
import pytest
from onnx import TensorProto, helper, numpy_helper
from onnx.reference import ReferenceEvaluator

from taxel import artifacts
from taxel.artifacts import Artifact
from taxel_bench.paper_size import write_paper_sized
from taxel_server.runtimes import Runtime, RuntimeOptions, open_runtime
from taxel_server.runtimes.networks import NetworkRuntime, runtime
from taxel_server.runtimes.networks.graph import read_graph
from taxel_server.runtimes.networks.lowering import lower
from taxel_server.runtimes.networks.runtime import ProgramEvaluator
from taxel_server.runtimes.onnx_models import OnnxRuntime

SHIPPED = Path(__file__).parents[3] / "models" / "repository"
NETWORKS = ["ffnn", "transformer", "network-a", "network-b"]
CELLS = [
    ("ffnn", 1),
    ("ffnn", 8),
    ("transformer", 1),
    ("transformer", 5),
    ("transformer", 8),
    ("network-b", 8),
]


@pytest.fixture(scope="module")
def paper_sized(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Artifact]:
    """Artifacts of the paper's size, each written once."""
    written: dict[tuple[str, int], Artifact] = {}

    def make(model: str, combination: int) -> Artifact:
        if (model, combination) not in written:
            repository = tmp_path_factory.mktemp("paper")
            write_paper_sized(repository, model, combination, seed=0)
            written[model, combination] = artifacts.read(repository / model / "1")
        return written[model, combination]

    return make


def windows_of(artifact: Artifact, rows: int) -> np.ndarray:
    statistics = artifact.manifest.normalisation
    draws = np.random.default_rng(rows).normal(size=(rows, len(statistics.input_mean)))
    return (draws * statistics.input_std + statistics.input_mean).astype(np.float32)


def on_onnx_runtime(path: Path, windows: np.ndarray) -> np.ndarray:
    """One window after the other."""
    session = onnxruntime.InferenceSession(path)
    return np.concatenate([session.run(None, {"window": each[None]})[0] for each in windows])


def in_float64(path: Path, windows: np.ndarray) -> np.ndarray:
    """What the weights in a file would give if nothing but them were rounded."""
    model = onnx.load(path)
    graph = model.graph
    for place, constant in enumerate(graph.initializer):
        if constant.data_type == TensorProto.FLOAT:
            content = numpy_helper.to_array(constant).astype(np.float64)
            graph.initializer[place].CopyFrom(numpy_helper.from_array(content, constant.name))
    for tensor in (*graph.input, *graph.output):
        tensor.type.tensor_type.elem_type = TensorProto.DOUBLE
    result: np.ndarray = ReferenceEvaluator(model).run(None, {"window": windows.astype(np.float64)})[0]
    return result


@pytest.mark.parametrize(("model", "combination"), CELLS)
def test_a_program_is_as_near_to_float64_as_onnx_runtime(
    model: str, combination: int, paper_sized: Callable[..., Artifact]
) -> None:
    artifact = paper_sized(model, combination)
    windows = windows_of(artifact, 40)
    exact = in_float64(artifact.model_path, windows)
    result = ProgramEvaluator(lower(read_graph(artifact.model_path))).counts(windows)
    theirs = np.abs(on_onnx_runtime(artifact.model_path, windows) - exact).mean()
    assert np.abs(result - exact).mean() < 2 * theirs
    largest = np.abs(result - exact).max() / np.array(artifact.manifest.normalisation.output_std).max()
    assert largest < 1e-5


@pytest.mark.parametrize("name", NETWORKS)
def test_shipped_networks_are_compiled(name: str) -> None:
    artifact = artifacts.read(SHIPPED / name / "1")
    opened = open_runtime(artifact)
    assert isinstance(opened, NetworkRuntime)
    assert opened.most_windows >= 1
    for rows in (1, opened.most_windows, opened.most_windows + 1, 70):
        windows = windows_of(artifact, rows)
        counts = opened.evaluate(windows)
        assert counts.shape == (rows, 21)
        np.testing.assert_allclose(counts, on_onnx_runtime(artifact.model_path, windows), atol=0.01, rtol=0)


def test_threads_get_their_own_answers() -> None:
    artifact = artifacts.read(SHIPPED / "transformer" / "1")
    opened = open_runtime(artifact)
    windows = windows_of(artifact, 200)
    expected = np.concatenate([opened.evaluate(each[None]) for each in windows])
    wrong: list[int] = []

    def ask(first: int) -> None:
        for _ in range(20):
            for place in range(first, len(windows), 7):
                if not np.array_equal(opened.evaluate(windows[place : place + 1])[0], expected[place]):
                    wrong.append(place)

    threads = [Thread(target=ask, args=(first,)) for first in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert wrong == []


def opened_as(artifact: Artifact, **options: Any) -> Runtime:
    return open_runtime(artifact, RuntimeOptions(**options))


def test_another_provider_gets_every_window() -> None:
    artifact = artifacts.read(SHIPPED / "ffnn" / "1")
    others = set(onnxruntime.get_available_providers()) - {"CPUExecutionProvider"}
    if not others:
        pytest.skip("ONNX Runtime knows only the processor here")
    opened = opened_as(artifact, providers=(others.pop(), "CPUExecutionProvider"))
    assert isinstance(opened, OnnxRuntime)
    assert isinstance(opened_as(artifact, threads=2), NetworkRuntime)


def test_without_programs_onnx_runtime_gets_every_window() -> None:
    artifact = artifacts.read(SHIPPED / "ffnn" / "1")
    assert isinstance(opened_as(artifact, network_program=False), OnnxRuntime)


def with_sine(path: Path) -> Path:
    """A network with an operation that programs do not have."""
    weights = np.random.default_rng(0).normal(size=(6, 21)).astype(np.float32)
    graph = helper.make_graph(
        [
            helper.make_node("Sin", ["window"], ["sine"]),
            helper.make_node("MatMul", ["sine", "w"], ["channels"]),
        ],
        "sine",
        [helper.make_tensor_value_info("window", TensorProto.FLOAT, ["n", 6])],
        [helper.make_tensor_value_info("channels", TensorProto.FLOAT, ["n", 21])],
        [numpy_helper.from_array(weights, "w")],
    )
    onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 20)], ir_version=10), path)
    return path


def test_what_cannot_be_compiled_is_left_to_onnx_runtime(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    normalisation = artifacts.read(SHIPPED / "ffnn" / "1").manifest.normalisation
    path = with_sine(tmp_path / "model.onnx")
    whole = OnnxRuntime(path, normalisation)
    with caplog.at_level(logging.INFO):
        assert runtime.faster_runtime(path, normalisation, whole) is whole
    assert "left to ONNX Runtime as a whole: Sin" in caplog.text


@pytest.mark.parametrize("error", [KeyError("odd"), IndexError()])
def test_a_graph_that_nobody_thought_of_is_served_all_the_same(
    error: Exception, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def fail(_: Any) -> None:
        raise error

    monkeypatch.setattr(runtime, "lower", fail)
    artifact = artifacts.read(SHIPPED / "ffnn" / "1")
    assert isinstance(open_runtime(artifact), OnnxRuntime)
    assert "could not be compiled" in caplog.text


def test_a_program_that_disagrees_is_not_used(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    original = ProgramEvaluator.evaluate
    artifact = artifacts.read(SHIPPED / "ffnn" / "1")
    std = artifact.manifest.normalisation.output_std[3]

    def a_little_off(self: ProgramEvaluator, windows: np.ndarray, result: np.ndarray) -> None:
        original(self, windows, result)
        result[-1, 3] += 3e-4 * std

    monkeypatch.setattr(ProgramEvaluator, "evaluate", a_little_off)
    assert isinstance(open_runtime(artifact), OnnxRuntime)
    assert "does not agree" in caplog.text


def test_a_program_that_this_processor_cannot_compile_is_not_used(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def fail(*_: Any) -> None:
        raise RuntimeError("no such instruction")

    monkeypatch.setattr(ProgramEvaluator, "evaluate", fail)
    assert isinstance(open_runtime(artifacts.read(SHIPPED / "ffnn" / "1")), OnnxRuntime)
    assert "could not be compiled" in caplog.text


def test_a_slower_program_is_not_used(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(runtime, "least_seconds", lambda *_: [1.0, 0.5])
    assert isinstance(open_runtime(artifacts.read(SHIPPED / "ffnn" / "1")), OnnxRuntime)


def test_a_program_takes_as_many_windows_as_it_is_faster_with(monkeypatch: pytest.MonkeyPatch) -> None:
    seconds = iter([[1.0, 1.5], [2.0, 2.5], [3.0, 3.5], [4.0, 3.5]])
    monkeypatch.setattr(runtime, "least_seconds", lambda *_: next(seconds))
    opened = open_runtime(artifacts.read(SHIPPED / "ffnn" / "1"))
    assert isinstance(opened, NetworkRuntime)
    assert opened.most_windows == 3


def check_shipped() -> None:
    """Compares programs of the shipped networks with ONNX Runtime; called on lesser processors, too."""
    for name in NETWORKS:
        artifact = artifacts.read(SHIPPED / name / "1")
        windows = windows_of(artifact, 30)
        expected = on_onnx_runtime(artifact.model_path, windows)
        result = ProgramEvaluator(lower(read_graph(artifact.model_path))).counts(windows)
        np.testing.assert_allclose(result, expected, atol=0.01, rtol=0)


@pytest.mark.long
def test_lesser_processors_agree(lesser_processor: Any) -> None:
    complaints = lesser_processor.complaints(f"""
import importlib.util
spec = importlib.util.spec_from_file_location("networks", {str(Path(__file__))!r})
networks = importlib.util.module_from_spec(spec)
spec.loader.exec_module(networks)
networks.check_shipped()
""")
    assert complaints == ""
