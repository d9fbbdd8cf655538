"""The ONNX Runtime runtime: what it takes, what it refuses."""

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from threading import Thread

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

from taxel.errors import ArtifactError
from taxel.manifest import Normalisation
from taxel_server.runtimes.onnx_models import OnnxRuntime

FOLDED = Normalisation(
    input_mean=(0.0,) * 6,
    input_std=(1.0,) * 6,
    output_mean=(0.0,) * 21,
    output_std=(1.0,) * 21,
    folded=True,
)
WEIGHTS = np.random.default_rng(0).normal(size=(6, 21)).astype(np.float32)


@pytest.fixture
def write(tmp_path: Path) -> Callable[..., Path]:
    """Writes a linear ONNX model with chosen names and shapes."""

    def make(given: str = "window", gives: str = "channels", features: int | str = 6) -> Path:
        graph = helper.make_graph(
            [helper.make_node("MatMul", [given, "weights"], [gives])],
            "linear",
            [helper.make_tensor_value_info(given, TensorProto.FLOAT, ["n", features])],
            [helper.make_tensor_value_info(gives, TensorProto.FLOAT, ["n", 21])],
            [numpy_helper.from_array(WEIGHTS, "weights")],
        )
        model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 20)], ir_version=10)
        path = tmp_path / "model.onnx"
        onnx.save(model, path)
        return path

    return make


@pytest.mark.parametrize("rows", [1, 7, 65_536])
@pytest.mark.parametrize("threads", [1, 2])
def test_it_evaluates_any_number_of_rows(write: Callable[..., Path], rows: int, threads: int) -> None:
    runtime = OnnxRuntime(write(), FOLDED, threads)
    windows = np.random.default_rng(1).normal(size=(rows, 6)).astype(np.float32)
    assert runtime.features == 6
    np.testing.assert_allclose(runtime.evaluate(windows), windows @ WEIGHTS, rtol=1e-4, atol=1e-4)


def test_threads_get_their_own_answers(write: Callable[..., Path]) -> None:
    runtime = OnnxRuntime(write(), FOLDED)
    wrong: list[int] = []

    def ask(seed: int) -> None:
        windows = np.random.default_rng(seed).normal(size=(9, 6)).astype(np.float32)
        for _ in range(100):
            if not np.allclose(runtime.evaluate(windows), windows @ WEIGHTS, rtol=1e-4, atol=1e-4):
                wrong.append(seed)

    threads = [Thread(target=ask, args=(seed,)) for seed in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert wrong == []


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"given": "x"}, r"\['x'\] to \['channels'\]: expected window to channels"),
        ({"gives": "y"}, r"\['window'\] to \['y'\]"),
        ({"features": "f"}, r"expected \(n, f\) to \(n, 21\)"),
    ],
)
def test_another_models_file_is_refused(
    write: Callable[..., Path], changes: dict[str, object], message: str
) -> None:
    with pytest.raises(ArtifactError, match=message):
        OnnxRuntime(write(**changes), FOLDED)


def test_damage_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "model.onnx"
    path.write_bytes(b"not onnx")
    with pytest.raises(ArtifactError, match="cannot load it"):
        OnnxRuntime(path, FOLDED)


def test_an_unknown_provider_is_refused(write: Callable[..., Path]) -> None:
    with pytest.raises(ArtifactError, match=r"no AbacusExecutionProvider here; it has: .*CPU"):
        OnnxRuntime(write(), FOLDED, providers=("AbacusExecutionProvider",))


def test_a_normalisation_outside_the_file_is_refused(write: Callable[..., Path]) -> None:
    with pytest.raises(ArtifactError, match="folded in"):
        OnnxRuntime(write(), FOLDED.model_copy(update={"folded": False}))


def test_onnx_runtime_measures_nobody(write: Callable[..., Path], tmp_path: Path) -> None:
    """By itself, it writes a number for the machine and what it measured into the user's cache."""
    model = write()
    home = tmp_path / "home"
    home.mkdir()
    code = (
        "import sys; from pathlib import Path; from taxel.manifest import Normalisation; "
        "from taxel_server.runtimes.onnx_models import OnnxRuntime; "
        "ones = (1.0,); OnnxRuntime(Path(sys.argv[1]), Normalisation(input_mean=ones * 6, "
        "input_std=ones * 6, output_mean=ones * 21, output_std=ones * 21, folded=True))"
    )
    environment = {name: value for name, value in os.environ.items() if name != "ORT_DISABLE_TELEMETRY"}
    environment |= {"HOME": str(home), "XDG_CACHE_HOME": str(home / ".cache")}
    subprocess.run([sys.executable, "-c", code, str(model)], env=environment, check=True)
    assert not list(home.rglob("*onnxruntime*"))
