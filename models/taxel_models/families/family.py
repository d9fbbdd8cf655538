"""The interface of a model family for training, export and study."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any, ClassVar, Final

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict

from taxel.windows import WindowSpec

Progress = Callable[[float, str], None]
"""Called with the share that is done, 0 to 1, and a note on the current work."""


def unseen(done: float, note: str) -> None:
    """A `Progress` that does nothing."""


class Hyperparameters(BaseModel):
    """Base of a family's hyperparameters: unknown ones are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True)


NO_EXTRAS: Final[Mapping[str, NDArray[np.float32]]] = MappingProxyType({})


@dataclass(frozen=True)
class FitData:
    """The training, validation or test set, as float32 z-scores.

    Attributes:
        windows: (n, f).
        channels: (n, 21).
        extras: (n,) each, by name: `tdc`, for families that take it as an input.
        auxiliary: (n, 2) `pac1` and `tac`, for families that are fitted to them as well.
    """

    windows: NDArray[np.float32]
    channels: NDArray[np.float32]
    extras: Mapping[str, NDArray[np.float32]]
    auxiliary: NDArray[np.float32]

    def __len__(self) -> int:
        return len(self.windows)


@dataclass(frozen=True)
class FitTask:
    """Everything that fitting may depend on.

    Attributes:
        spec: what the windows hold.
        seed: of every random choice.
        jobs: cores to use.
        extras: names of the extra inputs that a family may take, if it can.
        checkpoint: a file for the progress; an interrupted fit continues from it.
    """

    spec: WindowSpec
    train: FitData
    validation: FitData
    seed: int
    jobs: int
    progress: Progress = unseen
    extras: tuple[str, ...] = ()
    checkpoint: Path | None = None


class History(BaseModel):
    """How fitting went.

    Attributes:
        unit: what a step is: an epoch, or a tree of every channel.
        loss: what the losses are.
        train: the training loss after each step; empty if it is not known.
        validation: the validation loss after each step.
        best: the step, from 1, whose weights were kept; the last step if all were kept.
        notes: anything else worth keeping.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    unit: str
    loss: str
    train: tuple[float, ...]
    validation: tuple[float, ...]
    best: int
    notes: dict[str, Any]


class FittedModel(ABC):
    """A family's fitted model, in z-scores on both sides."""

    @property
    @abstractmethod
    def parameters(self) -> int:
        """Learnable parameters; for trees their nodes, as the paper counts."""

    @property
    def extras(self) -> tuple[str, ...]:
        """Names of the extra inputs that it takes behind its window."""
        return ()

    @abstractmethod
    def predict(
        self, windows: NDArray[np.float32], extras: Mapping[str, NDArray[np.float32]] = NO_EXTRAS
    ) -> NDArray[np.float32]:
        """Predict the channels, z-scores in and out.

        Args:
            windows: (n, f).
            extras: (n,) each, by name; the mean stands in for one that is not given. One that the model
                does not take is ignored: an ensemble gives all of them to each member.

        Returns:
            (n, 21).
        """

    @abstractmethod
    def save(self, folder: Path) -> None:
        """Write the weights into an existing, empty folder."""


class Family(ABC):
    """A kind of model."""

    name: ClassVar[str]
    hyperparameters: ClassVar[type[Hyperparameters]]

    @abstractmethod
    def paper_hyperparameters(self, combination: int) -> Mapping[str, Any]:
        """The published choice for an input combination."""

    def choose(self, combination: int, overrides: Mapping[str, Any]) -> dict[str, Any]:
        """The published choice with some of it replaced; not validated yet."""
        return {**self.paper_hyperparameters(combination), **overrides}

    @abstractmethod
    def fit(self, task: FitTask, hyperparameters: Hyperparameters) -> tuple[FittedModel, History]:
        """Fit to the training set, stopping early by the validation set."""

    @abstractmethod
    def load(self, folder: Path) -> FittedModel:
        """Read what `FittedModel.save` wrote.

        Raises:
            ArtifactError: the folder's content is damaged.
        """
