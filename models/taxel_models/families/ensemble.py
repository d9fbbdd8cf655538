"""Ensembles: several models of one or more families. Their mean is the prediction.

The paper suggests ensembles for the tip electrodes, where the errors of every model are largest. The
spread of the members shows where they disagree.
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Final

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from typing_extensions import override

from taxel.errors import ArtifactError, SettingsError
from taxel_models.families.family import (
    NO_EXTRAS,
    Family,
    FitTask,
    FittedModel,
    History,
    Hyperparameters,
)
from taxel_models.families.registry import family, resolve

_MEMBERS: Final = "ensemble.json"


class Member(Hyperparameters):
    """One model of an ensemble."""

    family: str
    hyperparameters: dict[str, Any]


class EnsembleHyperparameters(Hyperparameters):
    """The members. The seed of a member is the ensemble's seed plus the member's index."""

    members: Annotated[tuple[Member, ...], Field(min_length=2)]


class EnsembleModel(FittedModel):
    """Fitted members with the names of their families."""

    def __init__(self, members: tuple[tuple[str, FittedModel], ...]) -> None:
        self.members = members

    @property
    @override
    def parameters(self) -> int:
        return sum(model.parameters for _, model in self.members)

    @property
    @override
    def extras(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(name for _, model in self.members for name in model.extras))

    def predict_each(
        self, windows: NDArray[np.float32], extras: Mapping[str, NDArray[np.float32]] = NO_EXTRAS
    ) -> NDArray[np.float32]:
        """Every member's prediction, (members, n, 21), z-scores."""
        return np.stack([model.predict(windows, extras) for _, model in self.members])

    @override
    def predict(
        self, windows: NDArray[np.float32], extras: Mapping[str, NDArray[np.float32]] = NO_EXTRAS
    ) -> NDArray[np.float32]:
        mean: NDArray[np.float32] = self.predict_each(windows, extras).mean(axis=0)
        return mean

    @override
    def save(self, folder: Path) -> None:
        names = [name for name, _ in self.members]
        (folder / _MEMBERS).write_text(json.dumps({"families": names}) + "\n", encoding="utf-8")
        for number, (_, model) in enumerate(self.members, start=1):
            (folder / str(number)).mkdir()
            model.save(folder / str(number))


class EnsembleFamily(Family):
    """Members are chosen as `FAMILY:COUNT`, several with commas between them."""

    name = "ensemble"
    hyperparameters = EnsembleHyperparameters

    @override
    def paper_hyperparameters(self, combination: int) -> Mapping[str, Any]:
        raise SettingsError("an ensemble needs members: --members transformer:5, or ffnn:2,transformer:2")

    @override
    def choose(self, combination: int, overrides: Mapping[str, Any]) -> dict[str, Any]:
        """Each member with the paper's hyperparameters; `FAMILY.NAME` replaces one of a family's."""
        if "members" not in overrides:
            return dict(self.paper_hyperparameters(combination))
        chosen: dict[str, Any] = {key: value for key, value in overrides.items() if key != "members"}
        members = []
        for name, count in _parse(str(overrides["members"])):
            own = {
                key.removeprefix(f"{name}."): value
                for key, value in overrides.items()
                if key.startswith(f"{name}.")
            }
            member = {
                "family": name,
                "hyperparameters": resolve(family(name), combination, own).model_dump(mode="json"),
            }
            members += [member] * count
            chosen = {key: value for key, value in chosen.items() if not key.startswith(f"{name}.")}
        # The validation refuses, by name, what no member took.
        return {"members": members, **chosen}

    @override
    def fit(self, task: FitTask, hyperparameters: Hyperparameters) -> tuple[EnsembleModel, History]:
        chosen = EnsembleHyperparameters.model_validate(hyperparameters.model_dump())
        fitted, histories = [], []
        for number, member in enumerate(chosen.members):
            kind = family(member.family)
            own = _task_of_member(task, number, len(chosen.members))
            model, history = kind.fit(own, kind.hyperparameters.model_validate(member.hyperparameters))
            fitted.append((member.family, model))
            histories.append(history)
        model = EnsembleModel(tuple(fitted))
        return model, _history(model, task, histories)

    @override
    def load(self, folder: Path) -> EnsembleModel:
        path = folder / _MEMBERS
        try:
            names = json.loads(path.read_text(encoding="utf-8"))["families"]
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise ArtifactError(f"{path}: not the members that training wrote: {error}") from None
        return EnsembleModel(
            tuple((name, family(name).load(folder / str(number))) for number, name in enumerate(names, 1))
        )


def _parse(text: str) -> list[tuple[str, int]]:
    members = []
    for part in text.split(","):
        name, _, count = part.strip().partition(":")
        if name == EnsembleFamily.name or not (count or "1").isdecimal() or int(count or "1") < 1:
            raise SettingsError(f"--members {text}: expected FAMILY:COUNT, such as transformer:5,xgb:1")
        members.append((name, int(count or "1")))
    return members


def _task_of_member(task: FitTask, number: int, members: int) -> FitTask:
    checkpoint = task.checkpoint
    return FitTask(
        spec=task.spec,
        train=task.train,
        validation=task.validation,
        seed=task.seed + number,
        jobs=task.jobs,
        progress=lambda done, note: task.progress(
            (number + done) / members, f"member {number + 1} of {members}, {note}"
        ),
        extras=task.extras,
        checkpoint=checkpoint and checkpoint.with_name(f"{checkpoint.name}.{number + 1}"),
    )


def _history(model: EnsembleModel, task: FitTask, histories: list[History]) -> History:
    """The validation error of the first member, of the first two together, and so on."""
    part = task.validation
    each = model.predict_each(part.windows, part.extras)
    together = np.cumsum(each, axis=0) / np.arange(1, len(each) + 1)[:, None, None]
    errors = np.abs(together - part.channels).mean(axis=(1, 2))
    return History(
        unit="members",
        loss="mean absolute error, z-scores",
        train=(),
        validation=tuple(errors.tolist()),
        best=len(each),
        notes={"members": [history.model_dump(mode="json") for history in histories]},
    )
