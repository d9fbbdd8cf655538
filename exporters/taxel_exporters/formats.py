"""How each family is written as a model file. To add one, write its function and name it here."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from taxel.errors import ArtifactError
from taxel.manifest import Platform
from taxel_models.families.family import FittedModel
from taxel_models.training.trained import TrainedModel


@dataclass(frozen=True)
class ExportedModel:
    """A model file's content and how to evaluate it.

    Attributes:
        folded: the file takes raw windows and gives counts by itself.
        tolerance: largest difference from the trained model that the format explains, counts.
    """

    platform: Platform
    file_name: str
    content: bytes
    folded: bool
    tolerance: float


def _xgboost_json(fitted: FittedModel) -> ExportedModel:
    from taxel_exporters.merge import merge
    from taxel_models.families.xgb import XgbModel

    assert isinstance(fitted, XgbModel)
    return ExportedModel("xgboost_json", "model.json", merge(fitted.boosters), folded=False, tolerance=1e-3)


_WRITERS: Final[dict[str, Callable[[FittedModel], ExportedModel]]] = {"xgb": _xgboost_json}


def write(trained: TrainedModel) -> ExportedModel:
    """The model file of a trained model.

    Raises:
        ArtifactError: no format is known for its family.
    """
    name = trained.record.training.family
    if name not in _WRITERS:
        raise ArtifactError(f"no export for family {name!r}: expected one of {', '.join(_WRITERS)}")
    return _WRITERS[name](trained.fitted)
