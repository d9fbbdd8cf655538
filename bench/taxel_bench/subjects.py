"""What is measured: a model, an engine that evaluates it, and windows to feed it."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import taxel
from taxel.artifacts import MANIFEST
from taxel.manifest import Manifest
from taxel_models.shipped import shipped_repository


@dataclass(frozen=True)
class Subject:
    """One model under one engine.

    Attributes:
        model: as the user named it.
        engine: `taxel` for ours.
        size: `shipped` for an artifact as it is.
        threads: that evaluate one call.
        predict: (n, f) float32 raw windows to (n, 21) counts.
    """

    model: str
    engine: str
    size: str
    threads: int
    manifest: Manifest
    predict: Callable[[NDArray[np.float32]], NDArray[np.float32]]


@contextmanager
def artifact_subject(model: str) -> Iterator[Subject]:
    """An artifact in this process, evaluated as a server would.

    Args:
        model: the name of a shipped model, or the path of an artifact's folder.

    Raises:
        NotFound: it is neither.
        ArtifactError: the artifact is damaged.
    """
    folder = Path(model)
    if (folder / MANIFEST).is_file():
        version, name, repository = (
            folder.resolve().name,
            folder.resolve().parent.name,
            folder.resolve().parents[1],
        )
    else:
        repository, name, version = shipped_repository(), model, None
    with taxel.load(repository) as source:
        predictor = source.predictor(name, version)
        yield Subject(model, "taxel", "shipped", 1, predictor.manifest, predictor.predict)


def random_windows(manifest: Manifest, rows: int, seed: int) -> NDArray[np.float32]:
    """Windows drawn from the normal distribution of the model's training inputs, (rows, f)."""
    statistics = manifest.normalisation
    draws = np.random.default_rng(seed).standard_normal((rows, len(statistics.input_mean)))
    return (draws * statistics.input_std + statistics.input_mean).astype(np.float32)
