"""The engine: what a repository offers, and that a damaged artifact harms no other."""

import gc
import re
import shutil
import sys
import weakref
from collections.abc import Callable
from dataclasses import astuple
from pathlib import Path

import numpy as np
import pytest

from taxel.errors import ArtifactError, InvalidArgument, MissingDependency, NotFound, Unavailable
from taxel_models.shipped import shipped_repository
from taxel_server import engine as engine_module
from taxel_server.engine import Engine, load_model
from taxel_server.runtimes import Runtime


@pytest.fixture
def copied(repository: Path, tmp_path: Path) -> Path:
    """A copy of the repository, to damage."""
    return Path(shutil.copytree(repository, tmp_path / "repository"))


def states(engine: Engine) -> dict[str, str]:
    return {f"{model.name}/{model.version}": model.state for model in engine.models()}


def test_everything_is_offered_in_order(engine: Engine) -> None:
    offered = [(model.name, model.version, model.state, model.combination) for model in engine.models()]
    assert offered == [("skin", "2", "READY", 3), ("skin", "10", "READY", 3), ("wide", "1", "READY", 1)]


def test_a_loaded_model_names_its_evaluators(engine: Engine) -> None:
    for model in engine.models():
        runtime = engine.model(model.name, model.version).runtime
        assert "" not in (model.one_row, model.many_rows, model.instruction_set)
        assert (model.one_row, model.instruction_set) == astuple(runtime.evaluator(1))
        assert model.many_rows == runtime.evaluator(1024).name


@pytest.mark.parametrize("name", ["xgb", "ffnn", "transformer", "network-a", "network-b"])
def test_an_unloaded_model_needs_no_garbage_collector(name: str) -> None:
    """A server's collector never looks at what was there when it began to serve."""
    model = load_model(shipped_repository() / name / "1")
    gc.collect()
    gc.disable()
    try:
        left = weakref.ref(model), weakref.ref(model.runtime)
        del model
        assert [each() for each in left] == [None, None]
    finally:
        gc.enable()


def test_an_artifact_that_was_not_loaded_names_no_evaluator(repository: Path) -> None:
    assert {model.one_row for model in Engine(repository).models()} == {""}


def test_the_newest_version_is_meant_where_none_is_named(engine: Engine) -> None:
    assert engine.model("skin").manifest.version == "10"
    assert engine.model("skin", "2").manifest.version == "2"
    assert engine.model("skin") is engine.model("skin", "10")


@pytest.mark.parametrize(
    ("name", "version", "text"),
    [
        ("skn", None, "no model 'skn'; there is: skin, wide"),
        ("../skin", "2", "no model '../skin'"),
        ("skin", "3", "model 'skin' has no version '3'; it has: 2, 10"),
        ("skin", "", "model 'skin' has no version ''"),
    ],
)
def test_what_is_not_there_is_not_found(engine: Engine, name: str, version: str | None, text: str) -> None:
    with pytest.raises(NotFound, match=text):
        engine.model(name, version)


def test_a_version_that_is_no_text_is_told(engine: Engine) -> None:
    with pytest.raises(InvalidArgument, match="version is 2: expected a text such as '1', or None"):
        engine.model("skin", 2)  # type: ignore[arg-type]


def truncate(folder: Path) -> None:
    model = folder / "model.json"
    model.write_bytes(model.read_bytes()[:-100])


def replace(folder: Path) -> None:
    model = folder / "model.json"
    model.write_bytes(model.read_bytes().replace(b"1", b"2", 1))


def garble(folder: Path) -> None:
    (folder / "manifest.json").write_text('{"name": 1}')


def remove(folder: Path) -> None:
    shutil.rmtree(folder)
    folder.write_text("no folder")


@pytest.mark.parametrize(
    ("damage", "reason"),
    [
        (truncate, "bytes, but its manifest says"),
        (replace, "sha256"),
        (garble, "name"),
        (remove, "manifest.json"),
    ],
)
@pytest.mark.parametrize("eager", [True, False])
def test_a_damaged_artifact_is_unavailable_and_harms_no_other(
    copied: Path, damage: Callable[[Path], None], reason: str, eager: bool
) -> None:
    damage(copied / "skin" / "10")
    engine = Engine(copied)
    if eager:
        assert [loaded.label for loaded in engine.load_all()] == ["skin/2", "wide/1"]
    assert states(engine) == {"skin/2": "READY", "skin/10": "UNAVAILABLE", "wide/1": "READY"}
    assert reason in next(model.reason for model in engine.models() if model.state == "UNAVAILABLE")
    assert engine.model("skin").manifest.version == "2"
    with pytest.raises(Unavailable, match=f"model 'skin' cannot be loaded: version 10: .*{reason}"):
        engine.model("skin", "10")


def test_a_runtime_that_breaks_takes_only_its_model_along(
    repository: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    opening = engine_module.open_runtime

    def open_or_break(artifact: engine_module.artifacts.Artifact, threads: int) -> Runtime:
        if artifact.manifest.version == "10":
            raise ZeroDivisionError("layout")
        return opening(artifact, threads)

    monkeypatch.setattr(engine_module, "open_runtime", open_or_break)
    engine = Engine(repository)
    assert [loaded.label for loaded in engine.load_all()] == ["skin/2", "wide/1"]
    assert states(engine)["skin/10"] == "UNAVAILABLE"
    assert "ZeroDivisionError: layout" in caplog.text


@pytest.mark.parametrize(
    ("outputs", "text"),
    [(np.zeros((1, 20), np.float32), "predicts"), (np.full((1, 21), np.nan, np.float32), "not finite")],
)
def test_a_model_that_fails_its_first_prediction_is_unavailable(
    repository: Path, monkeypatch: pytest.MonkeyPatch, outputs: np.ndarray, text: str
) -> None:
    class Odd:
        features = 6
        parameters = 1

        def evaluate(self, windows: np.ndarray) -> np.ndarray:
            return np.repeat(outputs, len(windows), axis=0)

    monkeypatch.setattr(engine_module, "open_runtime", lambda *_: Odd())
    with pytest.raises(Unavailable, match=text):
        Engine(repository).model("skin")


def test_a_missing_library_is_told_with_its_remedy(
    repository: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def without(*_: object) -> Runtime:
        raise MissingDependency("platform xgboost_json", "numba", "server")

    monkeypatch.setattr(engine_module, "open_runtime", without)
    with pytest.raises(Unavailable, match=r"pip install 'taxel\[server\]'"):
        Engine(repository).model("skin")


@pytest.mark.parametrize(
    ("library", "reason"),
    [(None, r"needs numba: pip install 'taxel\[server\]'"), ("broken", "cannot be imported: ImportError")],
)
def test_a_model_whose_libraries_are_missing_is_never_listed_as_ready(
    repository: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, library: str | None, reason: str
) -> None:
    """`numba` is taken away, or replaced by a package that fails when it is imported."""
    for name in [name for name in sys.modules if name.startswith(("numba", "taxel_server.runtimes.trees"))]:
        monkeypatch.delitem(sys.modules, name)
    if library is None:
        monkeypatch.setitem(sys.modules, "numba", None)
    else:
        (tmp_path / "numba.py").write_text("raise ImportError('numba needs another NumPy')")
        monkeypatch.syspath_prepend(tmp_path)
    for model in Engine(repository).models():
        assert model.state == "UNAVAILABLE"
        assert re.search(reason, model.reason), model.reason


def test_a_repository_must_be_a_folder(tmp_path: Path) -> None:
    with pytest.raises(ArtifactError, match="no such folder"):
        Engine(tmp_path / "nowhere")


def test_an_empty_repository_offers_nothing(tmp_path: Path) -> None:
    engine = Engine(tmp_path)
    assert (engine.models(), engine.load_all()) == ([], [])
    with pytest.raises(NotFound, match="there is: none"):
        engine.model("skin")
