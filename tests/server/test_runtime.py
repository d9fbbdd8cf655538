"""Which runtime evaluates an artifact, and that it must agree with the manifest."""

import sys
from pathlib import Path

import pytest

from taxel import artifacts
from taxel.errors import ArtifactError, MissingDependency
from taxel_server.runtimes import open_runtime, runtime

SHIPPED = Path(__file__).parents[2] / "models" / "repository"


@pytest.fixture
def artifact(repository: Path) -> artifacts.Artifact:
    return artifacts.read(repository / "skin" / "2")


def test_trees_evaluate_xgboost(artifact: artifacts.Artifact) -> None:
    opened = open_runtime(artifact)
    assert opened.features == 6


def test_a_platform_without_a_runtime_is_refused(
    artifact: artifacts.Artifact, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delitem(runtime._MODULES, "xgboost_json")
    with pytest.raises(ArtifactError, match="no runtime for xgboost_json"):
        open_runtime(artifact)


def test_a_missing_library_is_told(artifact: artifacts.Artifact, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "numba", None)
    ours = "taxel_server.runtimes.trees", "taxel_server.runtimes.compiled"
    for name in [name for name in sys.modules if name.startswith(ours)]:
        monkeypatch.delitem(sys.modules, name)
    with pytest.raises(MissingDependency, match=r"numba: pip install 'taxel\[server\]'"):
        open_runtime(artifact)


def test_a_model_file_of_another_width_is_refused(repository: Path) -> None:
    wide = artifacts.read(repository / "wide" / "1")
    narrow = artifacts.read(repository / "skin" / "2")
    with pytest.raises(ArtifactError, match="expected 12"):
        open_runtime(artifacts.Artifact(wide.manifest, narrow.model_path))


def test_a_network_of_another_width_is_refused(
    artifact: artifacts.Artifact, caplog: pytest.LogCaptureFixture
) -> None:
    """The model file's twelve features, and a manifest of six."""
    folded = artifact.manifest.normalisation.model_copy(update={"folded": True})
    changes = {"platform": "onnxruntime_onnx", "normalisation": folded}
    manifest = artifact.manifest.model_copy(update=changes)
    with pytest.raises(ArtifactError, match="takes 12 features, but its manifest names 6"):
        open_runtime(artifacts.Artifact(manifest, SHIPPED / "ffnn" / "1" / "model.onnx"))
    assert caplog.text == ""
