"""An evaluation as a folder: raw figures, the table made of them, and two pictures."""

import json
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from taxel.atomic import whole_folder
from taxel.manifest import Normalisation
from taxel.windows.samples import GAP_NS
from taxel_models.evaluation import FIGURES
from taxel_models.evaluation.error_plots import draw_errors, draw_traces
from taxel_models.evaluation.metrics import ErrorMetrics
from taxel_models.templates import render

_TEMPLATE: Final = Path(__file__).parent / "templates" / "errors.md.j2"

_CHUNK: Final = 1000
"""The most windows in one stretch; each stretch is a value of the box plot."""


def write_report(
    folder: Path,
    *,
    about: dict[str, Any],
    time_ns: NDArray[np.int64],
    measured: NDArray[np.float64],
    predicted: NDArray[np.float32],
    normalisation: Normalisation,
) -> None:
    """Write `errors.json`, `errors.md`, `errors.png` and `traces.png`; an earlier report is replaced.

    Args:
        about: what was evaluated, as rows of the table's head.
        time_ns: (n,) the windows' times.
        measured: (n, 21) counts.
        predicted: (n, 21) counts.
        normalisation: from the model's training; its mean is the baseline's prediction.

    Raises:
        SettingsError: `folder` holds something other than a report.
    """
    std = normalisation.output_std
    errors = ErrorMetrics.of(measured, predicted, std)
    means = np.broadcast_to(np.asarray(normalisation.output_mean, np.float32), predicted.shape)
    baseline = ErrorMetrics.of(measured, means, std)
    stretches = [ErrorMetrics.of(measured[rows], predicted[rows], std) for rows in _stretches(time_ns)]
    by_stretch = np.stack([stretch.channel_norm_mae for stretch in stretches])
    raw = {
        "about": about,
        "model": errors.report(),
        "mean_predictor": baseline.report(),
        "norm_mae_by_stretch": by_stretch.round(6).tolist(),
    }
    title = ", ".join(f"{value}" for value in about.values())
    with whole_folder(folder, replacing=FIGURES) as place:
        (place / FIGURES).write_text(json.dumps(raw, indent=1) + "\n", encoding="utf-8")
        text = render(_TEMPLATE, about=about, errors=errors, baseline=baseline)
        (place / "errors.md").write_text(text, encoding="utf-8")
        draw_errors(errors, by_stretch, title, place / "errors.png")
        draw_traces(time_ns, measured, predicted, title, place / "traces.png")


def _stretches(time_ns: NDArray[np.int64]) -> list[slice]:
    """Windows without a gap between them, at most 1000 each: a trial, or a chunk of a long one."""
    edges = [0, *(np.flatnonzero(np.diff(time_ns) > GAP_NS) + 1).tolist(), len(time_ns)]
    return [
        slice(first, min(first + _CHUNK, stop))
        for start, stop in pairwise(edges)
        for first in range(start, stop, _CHUNK)
    ]
