"""Writes each family as a model file. To add a family, write its function and name it here."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

from taxel.errors import ArtifactError, SettingsError
from taxel.manifest import Platform
from taxel_models.training.trained import TrainedModel


@dataclass(frozen=True)
class ExportedModel:
    """A model file's content and how to evaluate it.

    Attributes:
        folded: the file takes raw windows and gives counts.
        tolerance: largest difference from the trained model that the format explains, counts.
            Rounded weights are judged by their error instead.
        spread: the file has a second output with the spread of its members.
        float32_size: if the weights are rounded, the file's bytes with the trained weights.
    """

    platform: Platform
    file_name: str
    content: bytes
    folded: bool
    tolerance: float
    spread: bool = False
    float32_size: int | None = None


def _xgboost_json(trained: TrainedModel) -> ExportedModel:
    from taxel_models.families.xgb import XgbModel
    from taxel_models.families.xgb_merge import merge

    assert isinstance(trained.fitted, XgbModel)
    content = merge(trained.fitted.boosters)
    return ExportedModel("xgboost_json", "model.json", content, folded=False, tolerance=1e-3)


def _trees_onnx(trained: TrainedModel) -> ExportedModel:
    from taxel_exporters.onnx_trees import trees_onnx

    content = trees_onnx(trained).SerializeToString(deterministic=True)
    return ExportedModel("onnxruntime_onnx", "model.onnx", content, folded=True, tolerance=5e-2)


def _network_onnx(trained: TrainedModel) -> ExportedModel:
    from taxel_exporters.onnx_network import network_onnx

    content = network_onnx(trained).SerializeToString(deterministic=True)
    return ExportedModel("onnxruntime_onnx", "model.onnx", content, folded=True, tolerance=5e-2)


def _ensemble_onnx(trained: TrainedModel) -> ExportedModel:
    from taxel_exporters.onnx_ensemble import ensemble_onnx

    content = ensemble_onnx(trained).SerializeToString(deterministic=True)
    return ExportedModel(
        "onnxruntime_onnx", "model.onnx", content, folded=True, tolerance=5e-2, spread=True
    )


_Writer = Callable[[TrainedModel], ExportedModel]

_WRITERS: Final[dict[str, dict[str, _Writer]]] = {
    "xgb": {"xgboost": _xgboost_json, "onnx": _trees_onnx},
    "ffnn": {"onnx": _network_onnx},
    "transformer": {"onnx": _network_onnx},
    "network-a": {"onnx": _network_onnx},
    "network-b": {"onnx": _network_onnx},
    "ensemble": {"onnx": _ensemble_onnx},
}
"""The formats of each family; the first is the default."""

_ROUNDABLE: Final = ("ffnn", "network-a", "network-b")
"""For one window, every layer has one row, so most of the time is spent on reading weights.

Transformers have one row for each token, and are slower with int8 weights.
"""


def write(trained: TrainedModel, model_format: str | None = None) -> ExportedModel:
    """The model file of a trained model.

    Raises:
        ArtifactError: its family cannot be written, or not in this format.
    """
    family = trained.record.training.family
    writers = _WRITERS.get(family)
    if writers is None:
        raise ArtifactError(f"no export for family {family!r}: expected one of {', '.join(_WRITERS)}")
    chosen = model_format or next(iter(writers))
    if chosen not in writers:
        raise ArtifactError(f"format {chosen!r} for {family}: expected one of {', '.join(writers)}")
    return writers[chosen](trained)


def write_int8(trained: TrainedModel, model_format: str | None = None) -> ExportedModel:
    """The model file of a trained model, with weights of 8 bits.

    Raises:
        SettingsError: a model of its family would be no faster, or none of its layers is large.
        ArtifactError: as `write`.
    """
    import onnx

    from taxel_exporters.onnx_int8 import with_int8_weights

    family = trained.record.training.family
    if family not in _ROUNDABLE:
        raise SettingsError(f"--weights int8: for {', '.join(_ROUNDABLE)} only, not for {family}")
    model = write(trained, model_format)
    content = with_int8_weights(onnx.load_from_string(model.content)).SerializeToString(deterministic=True)
    return replace(model, content=content, float32_size=len(model.content))
