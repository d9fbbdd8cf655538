"""Compares an artifact with its trained model on held-out windows."""

from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

import taxel
from taxel.manifest import Parity
from taxel_exporters.agreement import agreement
from taxel_models.training.dataset import EXTRAS, Examples
from taxel_models.training.trained import TrainedModel

MOST_WINDOWS: Final = 8192


def check_parity(
    repository: Path, name: str, trained: TrainedModel, held_out: Examples, tolerance: float
) -> Parity:
    """Compare the artifact, as it will be served, with the library that trained the model.

    Args:
        held_out: windows to compare on; if there are very many, evenly spaced ones are taken.
        tolerance: largest difference allowed, counts.

    Raises:
        ArtifactError: a prediction differs by more than `tolerance`, or is not finite.
    """
    rows = np.linspace(0, len(held_out) - 1, min(len(held_out), MOST_WINDOWS)).astype(np.int64)
    some = Examples(*(column[rows] for column in vars(held_out).values()))
    found, expected = predict_both(repository, name, trained, some)
    return agreement(found, expected, tolerance, "the trained model")


def predict_both(
    repository: Path, name: str, trained: TrainedModel, held_out: Examples
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """The predictions of the artifact, as it will be served, and of the trained model, (n, 21) each."""
    windows, columns = held_out.windows, held_out.extras.astype(np.float32)
    extras = {extra.name: columns[:, EXTRAS.index(extra.name)] for extra in trained.served_extras}
    expected = trained.predict(windows, extras)
    with taxel.load(repository) as source:
        found = source.predictor(name).predict(np.column_stack([windows, *extras.values()]))
    return found, expected
