"""A small repository of real XGBoost artifacts, and servers of it in this process."""

import hashlib
import os
import platform
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xgboost
from numpy.typing import NDArray

import taxel
from taxel.artifacts import MANIFEST, manifest_json
from taxel.manifest import Manifest, ModelFile, Normalisation, Training, WindowLayout, tensors
from taxel.remote import RemoteSource
from taxel_server.engine import Engine
from taxel_server.options import ServerOptions
from taxel_server.runtimes.compiled.processor import instruction_set
from taxel_server.service import Service
from taxel_server.transports.memory import MemoryServer

ArtifactMaker = Callable[..., Path]
WindowMaker = Callable[..., NDArray[np.float32]]
ServerStarter = Callable[..., str]

_PROCESSORS = {
    "AVX2": ("x86-64-v3", "+ssse3,+sse4.1,+sse4.2,+popcnt,+avx,+avx2,+bmi,+bmi2,+fma"),
    "SSE4": ("x86-64-v2", "+ssse3,+sse4.1,+sse4.2,+popcnt"),
    "SSE2": ("x86-64", "+sse2"),
}


@dataclass(frozen=True)
class Processor:
    """A lesser processor that numba can be told to compile for."""

    name: str
    model: str
    features: str

    def complaints(self, code: str) -> str:
        """What Python code says that fails in a process of its own, compiled for this processor."""
        restricted = {"NUMBA_CPU_NAME": self.model, "NUMBA_CPU_FEATURES": self.features}
        done = subprocess.run(
            [sys.executable, "-c", code], env=os.environ | restricted, capture_output=True, text=True
        )
        return done.stderr or "it failed without a word" if done.returncode else ""


@pytest.fixture(params=_PROCESSORS)
def lesser_processor(request: pytest.FixtureRequest) -> Processor:
    """Each of the lesser processors, where numba compiles for one of their kind."""
    if platform.machine() != "x86_64":
        pytest.skip("names x86 processors")
    if request.param == "AVX2" and instruction_set() == "avx2":
        pytest.skip("all tests run on such a processor here")
    return Processor(request.param, *_PROCESSORS[request.param])


def write_artifact(repository: Path, name: str, version: str, combination: int = 3) -> Path:
    """Train 21 outputs on random data and write them as an artifact; its folder."""
    spec = taxel.WindowSpec.of(combination)
    rng = np.random.default_rng([combination, int(version)])
    windows = rng.normal(size=(256, spec.length)).astype(np.float32)
    channels = np.tanh(windows @ rng.normal(size=(spec.length, 21)))
    booster = xgboost.train(
        {"max_depth": 4, "multi_strategy": "one_output_per_tree", "nthread": 1},
        xgboost.DMatrix(windows, channels, nthread=1),
        num_boost_round=4,
    )
    content = bytes(booster.save_raw("json"))
    inputs, outputs = tensors(WindowLayout.of(spec))
    manifest = Manifest(
        name=name,
        version=version,
        description="trained on random data",
        platform="xgboost_json",
        inputs=inputs,
        outputs=outputs,
        window=WindowLayout.of(spec),
        normalisation=Normalisation(
            input_mean=(0.1,) * spec.length,
            input_std=(1.5,) * spec.length,
            output_mean=(2000.0,) * 21,
            output_std=(300.0,) * 21,
        ),
        parameters=sum(len(tree.splitlines()) for tree in booster.get_dump()),
        training=Training(
            family="xgb", data=(), windows={}, split={}, seed=0, hyperparameters={}, metrics={}
        ),
        model_file=ModelFile(
            name="model.json", sha256=hashlib.sha256(content).hexdigest(), size=len(content)
        ),
        taxel_version=taxel.__version__,
    )
    folder = repository / name / version
    folder.mkdir(parents=True)
    (folder / "model.json").write_bytes(content)
    (folder / MANIFEST).write_text(manifest_json(manifest))
    return folder


@pytest.fixture(scope="session")
def make_artifact() -> ArtifactMaker:
    return write_artifact


@pytest.fixture(scope="session")
def repository(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """`skin` (combination 3) in versions 2 and 10, `wide` (combination 1) in version 1."""
    folder = tmp_path_factory.mktemp("repository")
    write_artifact(folder, "skin", "2")
    write_artifact(folder, "skin", "10")
    write_artifact(folder, "wide", "1", combination=1)
    return folder


@pytest.fixture(scope="session")
def engine(repository: Path) -> Engine:
    loaded = Engine(repository)
    loaded.load_all()
    return loaded


@pytest.fixture(scope="session")
def make_windows() -> WindowMaker:
    """Random windows, always the same for the same arguments."""

    def make(rows: int, features: int = 6, seed: int = 0) -> NDArray[np.float32]:
        return np.random.default_rng(seed).normal(size=(rows, features)).astype(np.float32)

    return make


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
    return port


@pytest.fixture
def endpoint() -> str:
    """Where nobody listens yet."""
    return f"tcp/127.0.0.1:{free_port()}"


@contextmanager
def serving() -> Iterator[ServerStarter]:
    with ExitStack() as servers:

        def serve(engine: Engine, **options: Any) -> str:
            place = f"tcp/127.0.0.1:{free_port()}"
            settings = ServerOptions(listen=(place,), **options)
            servers.callback(Service(engine, settings).start().close)
            return place

        yield serve


@pytest.fixture(scope="session")
def memory_server(engine: Engine) -> Iterator[MemoryServer]:
    """A server of the engine in this process, for tests that need no socket."""
    with MemoryServer(engine) as server:
        yield server


@pytest.fixture(scope="session")
def memory(memory_server: MemoryServer) -> Iterator[RemoteSource]:
    """A client of that server."""
    with taxel.connect(transport=memory_server) as source:
        yield source


@pytest.fixture
def start() -> Iterator[ServerStarter]:
    """Serves an engine in this process, with options; gives the endpoint."""
    with serving() as serve:
        yield serve


@pytest.fixture(scope="module")
def start_module() -> Iterator[ServerStarter]:
    """As `start`, for all tests of a file."""
    with serving() as serve:
        yield serve
