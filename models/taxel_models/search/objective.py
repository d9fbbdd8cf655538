"""What a search minimises: the normalised MAE on the validation set of a fitted configuration."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from ConfigSpace import Configuration

from taxel.errors import TaxelError
from taxel.windows import WindowSpec
from taxel_models.families.family import FitTask
from taxel_models.families.registry import family, resolve
from taxel_models.recordings import Recording
from taxel_models.search.search_settings import SearchSettings
from taxel_models.search.spaces import search_space
from taxel_models.training.dataset import Dataset
from taxel_models.training.train import Scalers

WORST: Final = 10.0
"""The cost of a diverged fit, and the largest cost. The mean predictor costs less than 1."""

TASK: Final = "task"
"""The name of the task when it is sent to workers."""


def fit_task(recordings: Sequence[Recording], settings: SearchSettings, jobs: int) -> FitTask:
    """The training and the validation set, z-scored by the training set; the test set stays unseen.

    Raises:
        SettingsError: the recordings cannot be split with these settings.
    """
    spec = WindowSpec.of(settings.combination)
    data = Dataset.of(recordings, spec, settings.split)
    scalers = Scalers.fit(data.train)
    return FitTask(spec, scalers.apply(data.train), scalers.apply(data.validation), settings.seed, jobs)


def hyperparameters_of(settings: SearchSettings, values: Mapping[str, Any]) -> dict[str, Any]:
    """A configuration as the family's hyperparameters, with those that are held."""
    plain = {
        name: value.item() if isinstance(value, np.generic) else value for name, value in values.items()
    }
    return search_space(settings.family).decode(plain) | settings.held


@dataclass(frozen=True)
class Objective:
    """SMAC's target function.

    Attributes:
        settings: settings of the search.
        task: the data to fit; None if it is sent to workers instead.
    """

    settings: SearchSettings
    task: FitTask | None

    def cost(
        self,
        config: Configuration,
        seed: int,  # noqa: ARG002
        budget: float | None = None,
        data_to_scatter: Mapping[str, FitTask] | None = None,
    ) -> tuple[float, dict[str, Any]]:
        """Fit a configuration.

        Args:
            config: in the family's space.
            seed: SMAC's. It is not used: every fit takes the seed of the settings, so that training
                with the best hyperparameters gives the same model.
            budget: epochs, for networks.
            data_to_scatter: the task, on a worker; the name is SMAC's.

        Returns:
            The normalised MAE on the validation set, and what else is worth keeping.
        """
        task = data_to_scatter[TASK] if data_to_scatter is not None else self.task
        assert task is not None
        chosen = hyperparameters_of(self.settings, config)
        if budget is not None:
            chosen["epochs"] = max(1, round(budget))
        kind = family(self.settings.family)
        hyperparameters = resolve(kind, self.settings.combination, chosen)
        try:
            fitted, history = kind.fit(task, hyperparameters)
        except TaxelError as error:
            return WORST, {"diverged": str(error)}
        predicted = fitted.predict(task.validation.windows)
        mae = float(np.abs(predicted - task.validation.channels).mean(dtype=np.float64))
        about = {"parameters": fitted.parameters, "best": history.best}
        return (mae if mae < WORST else WORST), about
