"""What tests of exported networks share."""

from collections.abc import Callable
from pathlib import Path

import pytest

from taxel_models.recordings import Recording
from taxel_models.training import trained as trained_models
from taxel_models.training.train import TrainingSettings, train
from taxel_models.twin import simulate

SaveTrained = Callable[[Path, TrainingSettings], Path]


@pytest.fixture(scope="session")
def little() -> list[Recording]:
    """Too little to tell what a model gets wrong anyway, which takes most of an export's time."""
    return [simulate(600, seed) for seed in (3, 4, 5)]


@pytest.fixture(scope="session")
def save_trained(little: list[Recording]) -> SaveTrained:
    """Trains on little and saves what comes of it in a folder, which is returned."""

    def saved(folder: Path, settings: TrainingSettings) -> Path:
        model, kept = train(little, settings)
        trained_models.save(model, kept, folder)
        return folder

    return saved
