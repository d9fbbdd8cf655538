"""An evaluation as a folder: raw figures, the table made of them, and two pictures."""

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from taxel.atomic import whole_folder
from taxel_models.evaluation import FIGURES
from taxel_models.evaluation.drawing import draw_errors, draw_traces
from taxel_models.evaluation.metrics import Errors


def write_report(
    folder: Path,
    *,
    about: dict[str, Any],
    time_ns: NDArray[np.int64],
    measured: NDArray[np.float64],
    predicted: NDArray[np.float32],
    errors: Errors,
    baseline: Errors,
) -> None:
    """Write `errors.json`, `errors.md`, `errors.png` and `traces.png`; an earlier report is replaced.

    Args:
        about: what was evaluated, as rows of the table's head.
        time_ns: (n,) the windows' times.
        measured: (n, 21) counts.
        predicted: (n, 21) counts.
        baseline: the errors of always saying the training mean.

    Raises:
        SettingsError: something else than a report stands at `folder`.
    """
    raw = {"about": about, "model": errors.report(), "mean_predictor": baseline.report()}
    title = ", ".join(f"{value}" for value in about.values())
    with whole_folder(folder, replacing=FIGURES) as place:
        (place / FIGURES).write_text(json.dumps(raw, indent=1) + "\n", encoding="utf-8")
        (place / "errors.md").write_text(_markdown(about, errors, baseline), encoding="utf-8")
        draw_errors(errors, title, place / "errors.png")
        draw_traces(time_ns, measured, predicted, title, place / "traces.png")


def _markdown(about: dict[str, Any], errors: Errors, baseline: Errors) -> str:
    head = "".join(f"- {name}: {value}\n" for name, value in about.items())
    rows = [
        ("**all 21**", errors.mae, errors.norm_mae, baseline.norm_mae),
        ("**electrodes**", errors.mae_electrodes, errors.norm_mae_electrodes, baseline.norm_mae_electrodes),
    ]
    other = baseline.per_channel()
    for channel, figures in errors.per_channel().items():
        rows.append((channel, figures["mae"], figures["norm_mae"], other[channel]["norm_mae"]))
    body = "".join(f"| {name} | {mae:.2f} | {norm:.3f} | {mean:.3f} |\n" for name, mae, norm, mean in rows)
    return (
        f"{head}- windows: {errors.rows}\n\n"
        "| channel | MAE, counts | normalised MAE | mean predictor's |\n| --- | --- | --- | --- |\n" + body
    )
