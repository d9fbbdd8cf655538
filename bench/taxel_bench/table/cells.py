"""A cell of the table: one model and input combination, measured, beside what was published."""

from collections.abc import Sequence
from typing import Any

from taxel.channels import CHANNELS
from taxel_bench.progress import Watch, ignore
from taxel_bench.run.protocols import Effort, run_serving
from taxel_bench.subjects.subject import open_subject
from taxel_models.families.networks.sizes import COMPARED, agrees
from taxel_models.families.published import (
    published_inference_ms,
    published_mflops,
    published_parameters,
)


def measure_cell(
    model: str, combination: int, batches: Sequence[int], effort: Effort, watch: Watch = ignore
) -> list[dict[str, Any]]:
    """Results as `bench run` gives them, each with what was `published` of the cell.

    `watch` is told which part is done.
    """
    published = published_cell(model, combination)
    with open_subject(model, combination=combination, size="paper", seed=effort.seed) as subject:
        results = run_serving(subject, batches, effort, lambda done: watch(done / len(batches)))
    return [result | {"published": published} for result in results]


def published_cell(model: str, combination: int) -> dict[str, Any]:
    """What the paper says of a model with an input combination.

    `inference_ms` is as printed: for `xgb` the time of one channel; `inference_ms_all_channels` is
    comparable between models. `consistent` is False where the paper's inference table and its
    hyperparameter table speak of networks of different size; ours follows the latter.
    """
    printed = published_inference_ms(model, combination)
    mflops = published_mflops(model, combination)
    return {
        "parameters": published_parameters(model, combination),
        "inference_ms": printed,
        "inference_ms_all_channels": printed * (len(CHANNELS) if model == "xgb" else 1),
        "flops": None if mflops is None else round(mflops * 1e6),
        "consistent": model not in COMPARED or agrees(model, combination),
    }
