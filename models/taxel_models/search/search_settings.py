"""The settings of a search: everything that its course depends on, kept beside its results."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Final, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, ValidationError, model_validator

from taxel.artifacts import describe
from taxel.atomic import check_folder_place, write_text
from taxel.errors import ArtifactError, SettingsError
from taxel_models.families.registry import family, resolve
from taxel_models.recordings import Recording
from taxel_models.search.spaces import search_space
from taxel_models.training.split import Grouping, SplitSettings

SETTINGS_FILE: Final = "search.json"

_SEARCHED: Final = ("neurons", "activations", "epochs")
"""Hyperparameters that follow from several dimensions of a space, or from a trial's budget."""


class SearchSettings(BaseModel):
    """The settings of a search. The same settings continue it.

    Attributes:
        family: to search for.
        combination: input combination 1..8.
        trials: number of fits; each fits one configuration with a number of epochs.
        walltime_s: the search stops after so many seconds, over all continuations.
        epochs: the largest budget of a network's trial.
        least_epochs: the smallest budget.
        held: hyperparameters that are set instead of searched.
        seed: of every random choice.
        grouping, test, validation, split_seed: see `SplitSettings`.
        data: name of each recording, by sha256.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, populate_by_name=True)

    schema_version: Literal[1] = 1
    family: str
    combination: Annotated[int, Field(ge=1, le=8)] = 1
    trials: Annotated[int, Field(ge=1)] = 100
    walltime_s: Annotated[FiniteFloat, Field(gt=0)] | None = None
    epochs: Annotated[int, Field(ge=1)] = 30
    least_epochs: Annotated[int, Field(ge=1)] = 3
    held: dict[str, Any] = {}
    seed: Annotated[int, Field(ge=0)] = 0
    grouping: Annotated[Grouping, Field(alias="unit")] = "auto"
    test: float = 0.1
    validation: float = 0.1
    split_seed: int = 0
    data: dict[str, str] = {}

    @model_validator(mode="after")
    def _budgets_in_order(self) -> "SearchSettings":
        if self.least_epochs > self.epochs:
            raise ValueError(f"least_epochs {self.least_epochs} is above epochs {self.epochs}")
        return self

    @classmethod
    def of(cls, recordings: Sequence[Recording], **settings: Any) -> Self:
        """The settings for these recordings.

        Raises:
            SettingsError: a setting is not possible.
        """
        data = {recording.fingerprint: recording.name for recording in recordings}
        try:
            complete = cls(data=data, **settings)
        except ValidationError as error:
            raise SettingsError(f"search: {describe(error)}") from None
        complete.check()
        return complete

    @property
    def split(self) -> SplitSettings:
        """How the recordings are divided."""
        return SplitSettings(self.grouping, self.test, self.validation, self.split_seed)

    def check(self) -> None:
        """Check the settings before any work.

        Raises:
            SettingsError: the family has no search space, or a hyperparameter cannot be held.
        """
        space, kind = search_space(self.family), family(self.family)
        resolve(kind, self.combination, self.held)
        for name in _SEARCHED:
            if name in self.held and name not in space.names:
                raise SettingsError(f"--set {name}: it is what is searched, or the budget of a trial")

    def keep(self, folder: Path) -> None:
        """Write the settings into a search's folder, or check that the search there has the same settings.

        Raises:
            SettingsError: the folder holds something else, or a search with other settings.
            ArtifactError: the settings that it holds are damaged.
        """
        path = folder / SETTINGS_FILE
        if not path.is_file():
            check_folder_place(folder)
            folder.mkdir(parents=True, exist_ok=True)
            write_text(path, self.model_dump_json(indent=1, by_alias=True) + "\n")
            return
        try:
            earlier = type(self).model_validate_json(path.read_bytes())
        except ValidationError as error:
            raise ArtifactError(f"{path}: {describe(error)}") from None
        for name, was in earlier:
            now = getattr(self, name)
            if was != now:
                raise SettingsError(
                    f"{folder} holds a search with {name} {was!r}, not {now!r}: "
                    "the same settings continue it; choose another folder for others"
                )
