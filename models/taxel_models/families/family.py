"""What a model family has to offer for training, export and study to work with it."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict

Progress = Callable[[float, str], None]
"""Told how much is done, 0 to 1, and what is going on."""


def unseen(done: float, note: str) -> None:
    """Progress that nobody watches."""


class Hyperparameters(BaseModel):
    """Base of a family's hyperparameters: unknown ones are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True)


@dataclass(frozen=True)
class FitPart:
    """One part of a data set, z-scored: windows (n, f) and channels (n, 21), float32."""

    windows: NDArray[np.float32]
    channels: NDArray[np.float32]


@dataclass(frozen=True)
class FitTask:
    """Everything that fitting may depend on.

    Attributes:
        seed: of every random choice.
        jobs: cores to use; never changes the result.
    """

    train: FitPart
    validation: FitPart
    seed: int
    jobs: int
    progress: Progress = unseen


class FittedModel(ABC):
    """A family's fitted model, in z-scores on both sides."""

    @property
    @abstractmethod
    def parameters(self) -> int:
        """Learnable parameters; for trees their nodes, as the paper counts."""

    @abstractmethod
    def predict(self, windows: NDArray[np.float32]) -> NDArray[np.float32]:
        """(n, f) z-scored windows to (n, 21) z-scored channels."""

    @abstractmethod
    def save(self, folder: Path) -> None:
        """Write the weights into an existing, empty folder."""

    @abstractmethod
    def history(self) -> dict[str, Any]:
        """How fitting went, for the trained model's record."""


class Family(ABC):
    """A kind of model."""

    name: ClassVar[str]
    hyperparameters: ClassVar[type[Hyperparameters]]

    @abstractmethod
    def paper_hyperparameters(self, combination: int) -> Mapping[str, Any]:
        """The published choice for an input combination."""

    @abstractmethod
    def fit(self, task: FitTask, hyperparameters: Hyperparameters) -> FittedModel:
        """Fit to the training part, stopping early by the validation part."""

    @abstractmethod
    def load(self, folder: Path) -> FittedModel:
        """Read what `FittedModel.save` wrote.

        Raises:
            ArtifactError: the folder's content is damaged.
        """
