"""Subjects of the benchmark: a model with our runtime and the engines that it is compared with."""

import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from taxel.artifacts import MANIFEST, Artifact, folder_of, read
from taxel.errors import SettingsError
from taxel.manifest import Manifest
from taxel_bench.engines import Engine, base_engine, taxel_engine
from taxel_bench.forests import TreeShape
from taxel_bench.paper_size import PAPER_MODELS, write_paper_sized
from taxel_bench.peers.selection import NO_PEERS, PeerChoice
from taxel_bench.subjects.other_engines import OtherEngines
from taxel_bench.subjects.threads import pinned_threads
from taxel_models.shipped import shipped_repository
from taxel_server.engine import load_model
from taxel_server.local import LocalPredictor, LocalSource
from taxel_server.runtimes import EvaluatorInfo

Size = Literal["paper", "shipped"]


@dataclass(frozen=True)
class Subject:
    """One model under our runtime and other engines.

    Attributes:
        model: as the user named it.
        size: `shipped` for an artifact as it is, `paper` for one of the published size.
        trees: how the trees of a random forest grow; None for any other model.
        taxel: our runtime.
        baseline: the published way; of a corrected model, its base. None where there is neither for
            this artifact, and `notes` say why.
        peers: other libraries that evaluate the same model file.
        skipped: peers that cannot, each with the reason.
        predict: what a user calls in process: our runtime and its checks.
        evaluator: which of our evaluators computes so many windows.
        notes: what a reader of the figures must know.
    """

    model: str
    size: Size
    trees: TreeShape | None
    manifest: Manifest
    taxel: Engine
    baseline: Engine | None
    peers: tuple[Engine, ...]
    skipped: dict[str, str]
    predict: Callable[[NDArray[np.float32]], NDArray[np.float32]]
    evaluator: Callable[[int], EvaluatorInfo]
    notes: tuple[str, ...]

    @property
    def engines(self) -> tuple[Engine, ...]:
        """All engines, the baseline first and ours last."""
        baseline = () if self.baseline is None else (self.baseline,)
        return (*baseline, *self.peers, self.taxel)


@contextmanager
def open_subject(
    model: str,
    *,
    combination: int | None = None,
    size: Size | None = None,
    trees: TreeShape | None = None,
    seed: int = 0,
    peers: PeerChoice = NO_PEERS,
) -> Iterator[Subject]:
    """A model in this process under our runtime and other engines.

    Args:
        model: a shipped model's name, or the path of an artifact's folder.
        combination: input combination 1..8; the artifact's own, or 1 at the paper's size, if None.
        size: `shipped` if None, unless the shipped model has another combination or `trees` are chosen.
        trees: how a forest of the paper's size grows; even if None.
        seed: of the weights of models that are not shipped.
        peers: that are asked for.

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
            subject = _subject(model, "paper", grown if model == "xgb" else None, folder, peers)
        else:
            subject = _subject(model, "shipped", None, folder, peers)
        # Peers may have loaded further libraries with threads of their own.
        with pinned_threads():
            yield subject


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


def _subject(model: str, size: Size, trees: TreeShape | None, folder: Path, choice: PeerChoice) -> Subject:
    artifact = read(folder)
    manifest = artifact.manifest
    loaded = load_model(folder)
    if manifest.effects and choice.names != ():
        raise SettingsError(f"--peers: {model} is corrected by effects, which no peer evaluates")
    others = _other_engines(artifact, choice)
    baseline, flops, notes = others.baseline, others.flops, others.notes
    if manifest.effects:
        baseline = base_engine(artifact, flops)
        notes = [note for note in notes if not note.startswith("paper:")]
        notes += _correction_notes(manifest, flops)
    return Subject(
        model=model,
        size=size,
        trees=trees,
        manifest=manifest,
        taxel=taxel_engine(loaded, flops),
        baseline=baseline,
        peers=others.peers,
        skipped=others.skipped,
        predict=LocalPredictor(LocalSource(folder.parents[1]), loaded).predict,
        evaluator=loaded.runtime.evaluator,
        notes=tuple(notes),
    )


def _other_engines(artifact: Artifact, choice: PeerChoice) -> OtherEngines:
    # Each side imports libraries for seconds that the other has no use for: XGBoost and torch.
    if artifact.manifest.platform == "xgboost_json":
        from taxel_bench.subjects.forest import engines_beside_forest as beside
    else:
        from taxel_bench.subjects.graph import engines_beside_graph as beside
    # Again, for the libraries that came with it.
    with pinned_threads():
        return beside(artifact, choice)


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
