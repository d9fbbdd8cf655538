"""The published training recipe: loss, optimiser, early stopping, best weights kept.

Interrupted training continues from its checkpoint. On a CPU, the following epochs are the same as without
the interruption. On a GPU, dropout draws other numbers.
"""

import copy
import logging
import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field
from torch import Tensor, nn

from taxel.errors import TaxelError
from taxel_models.families.family import FitTask, History, Hyperparameters

_LOG: Final = logging.getLogger(__name__)

LOSS: Final = "mean of |e| + e^2, z-scores"


class Recipe(Hyperparameters):
    """How a network is trained; the paper's text, unless a result says otherwise.

    `optimizer`: the text says Adam; the published transformer script used AdamW, with `milestones`
    (epochs at which the learning rate is cut tenfold) at 100 and 150.
    `patience`: epochs without a better validation loss before training stops; 0 never stops early,
    as the paper's Network B.
    """

    batch_size: Annotated[int, Field(ge=1)]
    learning_rate: Annotated[float, Field(gt=0)]
    epochs: Annotated[int, Field(ge=1)] = 300
    patience: Annotated[int, Field(ge=0)] = 8
    optimizer: Literal["adam", "adamw"] = "adam"
    betas: tuple[float, float] = (0.9, 0.999)
    milestones: tuple[int, ...] = ()


def loss_of(predicted: Tensor, expected: Tensor) -> Tensor:
    """mean(|e| + e²), equation 1 of the paper, after Ruppel et al. 2018."""
    error = predicted - expected
    return (error.abs() + error.square()).mean()


def device() -> torch.device:
    """The GPU, if there is one; else the CPU."""
    return torch.device("cuda" if torch.cuda.is_available() else "cpu")


@dataclass
class _State:
    """Everything that the next epoch depends on besides the data."""

    epoch: int = 0
    train: list[float] = field(default_factory=list)
    validation: list[float] = field(default_factory=list)
    best: int = 0
    best_weights: dict[str, Tensor] = field(default_factory=dict)


class Trainer:
    """Trains one network to one task.

    Args:
        network: takes (n, columns) and gives (n, outputs), z-scores.
        inputs: the training and the validation set's columns.
        targets: their expected outputs.
    """

    def __init__(
        self,
        network: nn.Module,
        inputs: tuple[NDArray[np.float32], NDArray[np.float32]],
        targets: tuple[NDArray[np.float32], NDArray[np.float32]],
        recipe: Recipe,
        task: FitTask,
    ) -> None:
        self._device = device()
        self._network = network.to(self._device)
        self._inputs = tuple(torch.from_numpy(part).to(self._device) for part in inputs)
        self._targets = tuple(torch.from_numpy(part).to(self._device) for part in targets)
        self._recipe = recipe
        self._task = task
        kind = torch.optim.Adam if recipe.optimizer == "adam" else torch.optim.AdamW
        self._optimizer = kind(network.parameters(), lr=recipe.learning_rate, betas=recipe.betas)
        self._schedule = torch.optim.lr_scheduler.MultiStepLR(
            self._optimizer, list(recipe.milestones), gamma=0.1
        )
        # Shuffling has a generator of its own on the CPU, so that it does not depend on the device.
        self._shuffle = torch.Generator().manual_seed(task.seed)
        self._state = _State()

    def train(self) -> History:
        """Run epochs until the recipe says stop. Afterwards the network has its best weights."""
        torch.set_num_threads(max(1, self._task.jobs))
        self._resume()
        while not self._done():
            self._epoch()
            self._keep()
        self._network.load_state_dict(self._state.best_weights)
        self._network.eval()
        if self._task.checkpoint is not None:
            self._task.checkpoint.unlink(missing_ok=True)
        notes = {"optimizer": self._recipe.optimizer, "device": self._device.type}
        return History(
            unit="epoch",
            loss=LOSS,
            train=tuple(self._state.train),
            validation=tuple(self._state.validation),
            best=self._state.best,
            notes=notes,
        )

    def _done(self) -> bool:
        waited = self._state.epoch - self._state.best
        patience = self._recipe.patience
        return self._state.epoch >= self._recipe.epochs or bool(patience and waited >= patience)

    def _epoch(self) -> None:
        self._network.train()
        inputs, targets = self._inputs[0], self._targets[0]
        order = torch.randperm(len(inputs), generator=self._shuffle).to(self._device)
        total = 0.0
        for rows in torch.split(order, self._recipe.batch_size):
            self._optimizer.zero_grad(set_to_none=True)
            loss = loss_of(self._network(inputs[rows]), targets[rows])
            loss.backward()  # type: ignore[no-untyped-call]
            self._optimizer.step()
            total += loss.item() * len(rows)
        if not math.isfinite(total):
            raise TaxelError(
                f"the loss is {total} in epoch {self._state.epoch + 1}: expected a finite one; "
                f"lower the learning rate, {self._recipe.learning_rate:g}"
            )
        self._schedule.step()
        self._state.epoch += 1
        self._state.train.append(total / len(inputs))
        self._state.validation.append(self._validate())

    @torch.inference_mode()
    def _validate(self) -> float:
        self._network.eval()
        inputs, targets = self._inputs[1], self._targets[1]
        total = 0.0
        for start in range(0, len(inputs), 8192):
            rows = slice(start, start + 8192)
            total += loss_of(self._network(inputs[rows]), targets[rows]).item() * len(inputs[rows])
        return total / len(inputs)

    def _keep(self) -> None:
        state = self._state
        if not state.best or state.validation[-1] < state.validation[state.best - 1]:
            state.best = state.epoch
            state.best_weights = copy.deepcopy(self._network.state_dict())
        note = (
            f"epoch {state.epoch}: train {state.train[-1]:.4f}, validation {state.validation[-1]:.4f}, "
            f"best {state.validation[state.best - 1]:.4f} at {state.best}"
        )
        self._task.progress(state.epoch / self._recipe.epochs, note)
        if self._task.checkpoint is not None:
            _save(self._task.checkpoint, self._snapshot())

    def _snapshot(self) -> dict[str, Any]:
        return {
            "fingerprint": self._fingerprint(),
            "state": vars(self._state),
            "network": self._network.state_dict(),
            "optimizer": self._optimizer.state_dict(),
            "schedule": self._schedule.state_dict(),
            "shuffle": self._shuffle.get_state(),
            "random": torch.get_rng_state(),
        }

    def _resume(self) -> None:
        path = self._task.checkpoint
        if path is None or not path.exists():
            return
        try:
            snapshot = torch.load(path, map_location=self._device, weights_only=True)
            agrees = snapshot["fingerprint"] == self._fingerprint()
        except Exception as error:  # torch and pickle raise whatever they like on damaged files
            _LOG.warning("%s cannot be read (%r): training starts again", path, error)
            return
        if not agrees:
            return
        self._state = _State(**snapshot["state"])
        self._network.load_state_dict(snapshot["network"])
        self._optimizer.load_state_dict(snapshot["optimizer"])
        self._schedule.load_state_dict(snapshot["schedule"])
        self._shuffle.set_state(snapshot["shuffle"].cpu())
        torch.set_rng_state(snapshot["random"].cpu())

    def _fingerprint(self) -> str:
        """What a checkpoint must match: recipe, seed, network and data."""
        shapes = {name: tuple(value.shape) for name, value in self._network.state_dict().items()}
        sums = [float(part.double().sum()) for part in (*self._inputs, *self._targets)]
        return repr((self._recipe.model_dump(), self._task.seed, shapes, sums))


def _save(path: Path, snapshot: dict[str, Any]) -> None:
    temporary = path.with_name(path.name + ".part")
    torch.save(snapshot, temporary)
    temporary.replace(path)
