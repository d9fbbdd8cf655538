"""Hyperparameters as a file: what a search writes and training takes."""

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from taxel.artifacts import describe
from taxel.errors import SettingsError
from taxel_models.families.registry import family as family_of
from taxel_models.families.registry import resolve


class FoundHyperparameters(BaseModel):
    """The content of the file.

    Attributes:
        family: the model family that they are for.
        combination: the input combination that they were found with.
        hyperparameters: those that replace the paper's; others stay as published.
        origin: how they were found.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    schema_version: Literal[1] = 1
    family: str
    combination: Annotated[int, Field(ge=1, le=8)]
    hyperparameters: dict[str, Any]
    origin: dict[str, Any] = {}


def read_hyperparameters(path: Path, family: str, combination: int) -> dict[str, Any]:
    """Read the hyperparameters in a file, for a family and an input combination.

    Raises:
        SettingsError: the file is no such file, is for another family or combination, or holds a
            hyperparameter that the family does not know or take.
    """
    try:
        found = FoundHyperparameters.model_validate_json(path.read_bytes())
    except OSError as error:
        raise SettingsError(f"{path}: {error.strerror}; expected what `taxel search` wrote") from None
    except ValidationError as error:
        raise SettingsError(f"{path}: {describe(error)}; expected what `taxel search` wrote") from None
    if (found.family, found.combination) != (family, combination):
        raise SettingsError(
            f"{path}: hyperparameters of {found.family} for inputs {found.combination}; "
            f"expected those of {family} for inputs {combination}"
        )
    try:
        resolve(family_of(family), combination, found.hyperparameters)
    except SettingsError as error:
        raise SettingsError(f"{path}: {error}") from None
    return found.hyperparameters
