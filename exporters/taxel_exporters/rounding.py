"""Checks the error of an artifact with rounded weights on all held-out windows."""

from pathlib import Path
from typing import Final

from taxel.errors import ArtifactError
from taxel.manifest import RoundedWeights
from taxel_exporters.parity import predict_both
from taxel_models.evaluation.metrics import ErrorMetrics
from taxel_models.training.dataset import Examples
from taxel_models.training.trained import TrainedModel

LARGEST_RISE: Final = 0.01
"""The largest rise of the normalised mean absolute error, relative to the trained model's."""


def check_rounding(
    repository: Path, name: str, trained: TrainedModel, held_out: Examples, float32_size: int
) -> RoundedWeights:
    """Compare the artifact, as it will be served, and the trained model with what was measured.

    Args:
        held_out: windows and the channels measured at them.
        float32_size: bytes that the model file has with its weights as trained.

    Raises:
        ArtifactError: rounding raises the normalised error by more than `LARGEST_RISE`.
    """
    found, expected = predict_both(repository, name, trained, held_out)
    std = trained.record.normalisation.output_std
    rounded = ErrorMetrics.of(held_out.channels, found, std).norm_mae
    exact = ErrorMetrics.of(held_out.channels, expected, std).norm_mae
    if not rounded <= exact * (1 + LARGEST_RISE):
        raise ArtifactError(
            f"rounded weights: normalised MAE {rounded:.5g} on {len(held_out)} held-out windows, with "
            f"float32 weights {exact:.5g} ({rounded / exact - 1:+.2%}): "
            f"expected at most {LARGEST_RISE:+.0%}; use --weights float32"
        )
    return RoundedWeights(
        datatype="INT8",
        windows=len(held_out),
        norm_mae=rounded,
        float32_norm_mae=exact,
        float32_size=float32_size,
    )
