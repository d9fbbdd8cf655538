"""What is measured: one model under our runtime, and under another engine beside it."""

import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal

import numpy as np
import onnx
from numpy.typing import NDArray

from taxel.artifacts import MANIFEST, Artifact, folder_of, read
from taxel.errors import ArtifactError, SettingsError
from taxel.manifest import Manifest
from taxel_bench.engines import Engine, base_engine, taxel_engine
from taxel_bench.operations.of_graph import count_graph_operations
from taxel_bench.paper_size import PAPER_MODELS, TreeShape, write_paper_sized
from taxel_bench.published_way.eager import eager_engine, pinned_threads
from taxel_bench.published_way.networks import network_of
from taxel_bench.published_way.regressors import Regressors
from taxel_bench.windows import random_windows
from taxel_models.shipped import shipped_repository
from taxel_server.engine import load_model
from taxel_server.local import LocalPredictor, LocalSource

Size = Literal["paper", "shipped"]

_OPERATION_WINDOWS: Final = 64
"""Over which the operations of trees are averaged."""

_TREES_TOLERANCE: Final = 0.0
_NETWORK_TOLERANCE: Final = 1e-4
"""Largest difference between the engines, in standard deviations of a channel."""


@dataclass(frozen=True)
class Subject:
    """One model under our runtime and another engine.

    Attributes:
        model: as the user named it.
        size: `shipped` for an artifact as it is, `paper` for one of the published size.
        trees: how the trees of a forest from a seed grow; None for any other model.
        taxel: our runtime.
        peer: the published way; of a corrected model, its base. None where there is neither for
            this artifact, and `notes` say why.
        predict: what a user calls in process: our runtime behind its checks.
        tolerance: standard deviations by which the engines' counts may differ; None where their
            values are not to be compared, and `notes` say why.
        notes: what a reader of the figures has to know.
    """

    model: str
    size: Size
    trees: TreeShape | None
    manifest: Manifest
    taxel: Engine
    peer: Engine | None
    predict: Callable[[NDArray[np.float32]], NDArray[np.float32]]
    tolerance: float | None
    notes: tuple[str, ...]

    @property
    def engines(self) -> tuple[Engine, ...]:
        """Ours last: what is timed after another engine finds cold caches."""
        return (self.taxel,) if self.peer is None else (self.peer, self.taxel)


@contextmanager
def open_subject(
    model: str,
    *,
    combination: int | None = None,
    size: Size | None = None,
    trees: TreeShape | None = None,
    seed: int = 0,
) -> Iterator[Subject]:
    """A model in this process under our runtime and another engine.

    Args:
        model: a shipped model's name, or the path of an artifact's folder.
        combination: input combination 1..8; the artifact's own, or 1 at the paper's size, if None.
        size: `shipped` if None, unless the shipped model has another combination or `trees` are chosen.
        trees: how a forest of the paper's size grows; even if None.
        seed: of the weights of models that are not shipped.

    Raises:
        SettingsError: the choices do not go together.
        NotFound: there is no such model.
        ArtifactError: the artifact is damaged.
    """
    if trees is not None and size is None and model == "xgb":
        size = "paper"
    folder = None if size == "paper" else _artifact_folder(model, combination, size)
    if folder is None and Path(model, MANIFEST).is_file():
        raise SettingsError(f"--model {model} is an artifact: it has its own size and inputs")
    if trees is not None and (folder is not None or model != "xgb"):
        raise SettingsError(f"--trees {trees} shapes the forest of --model xgb --size paper alone")
    with tempfile.TemporaryDirectory(prefix="taxel-bench-") as place, pinned_threads():
        if folder is None:
            grown = trees or "even"
            folder = write_paper_sized(Path(place), model, combination or 1, seed=seed, trees=grown)
            yield _subject(model, "paper", grown if model == "xgb" else None, folder)
        else:
            yield _subject(model, "shipped", None, folder)


def _artifact_folder(model: str, combination: int | None, size: Size | None) -> Path | None:
    """The artifact to measure; None where other inputs than its own ask for the paper's size."""
    if (Path(model) / MANIFEST).is_file():
        folder = Path(model).resolve()
    else:
        folder = folder_of(shipped_repository(), model)
    own = read(folder).manifest.window.combination
    if combination in (None, own):
        return folder
    if size is None and model in PAPER_MODELS:
        return None
    raise SettingsError(f"--inputs {combination}: {model} takes input combination {own}")


def _subject(model: str, size: Size, trees: TreeShape | None, folder: Path) -> Subject:
    artifact = read(folder)
    manifest = artifact.manifest
    loaded = load_model(folder)
    peer: Engine | None = None
    tolerance: float | None = _TREES_TOLERANCE
    notes: list[str] = []
    if manifest.platform == "xgboost_json":
        windows = random_windows(manifest, _OPERATION_WINDOWS, seed=0)[:, : manifest.window.model_columns]
        peer = Regressors(artifact.model_path, manifest).engine(windows)
        flops = peer.flops
    else:
        graph = onnx.load(artifact.model_path)
        flops, notes = _graph_operations(graph)
        if not manifest.effects:
            peer, tolerance = _network_peer(artifact, graph.graph, notes)
    if manifest.effects:
        peer, tolerance = base_engine(artifact, flops), None
        notes += _correction_notes(manifest, flops)
    return Subject(
        model=model,
        size=size,
        trees=trees,
        manifest=manifest,
        taxel=taxel_engine(loaded, flops),
        peer=peer,
        predict=LocalPredictor(LocalSource(folder.parents[1]), loaded).predict,
        tolerance=tolerance,
        notes=tuple(notes),
    )


def _graph_operations(model: onnx.ModelProto) -> tuple[int | None, list[str]]:
    """Operations of a graph, or a note on why they cannot be counted."""
    try:
        return count_graph_operations(model), []
    except ArtifactError as error:
        return None, [f"flops: {error}"]


def _network_peer(
    artifact: Artifact, graph: onnx.GraphProto, notes: list[str]
) -> tuple[Engine | None, float | None]:
    """The published way of a network, and how far its values may be away; adds to the notes."""
    found = network_of(artifact.manifest, graph)
    if found is None:
        notes.append("paper: this artifact is not of a single network of ours: there is no published way")
        return None, None
    network, same_weights = found
    if not same_weights:
        notes.append("paper: other weights of the same architecture: compares speed, not values")
    return eager_engine(network, artifact.manifest), _NETWORK_TOLERANCE if same_weights else None


def _correction_notes(manifest: Manifest, flops: int | None) -> list[str]:
    """What to know of the figures of a corrected model."""
    names = ", ".join(effect.name for effect in manifest.effects)
    notes = [
        "paper: nothing was published that corrects its predictions; beside it stands its base, the same "
        f"model file without its effects ({names})"
    ]
    if defaults := [f"{extra.name} = {extra.default:g}" for extra in manifest.window.effect_extras]:
        notes.append(f"windows: what only the effects take has its default: {', '.join(defaults)}")
    if flops is not None:
        notes.append("flops: of the model file alone, without its effects")
    return notes
