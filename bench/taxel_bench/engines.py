"""Engines: the ways of evaluating a model that are timed in turn."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from taxel.artifacts import Artifact
from taxel.channels import CHANNELS
from taxel_server.engine import LoadedModel
from taxel_server.runtimes import open_runtime

TAXEL: Final = "taxel"
PUBLISHED: Final = "paper"
BASE: Final = "base"
"""Names of engines; any other engine has its peer's name."""

SAME_ANSWERS: Final = 1e-4
"""The largest difference of answers whose sums have another order, in standard deviations of a channel."""

THREADS: Final = 1
"""How many threads of every engine evaluate a call."""


@dataclass(frozen=True)
class Engine:
    """One way of evaluating a model.

    Attributes:
        name: `taxel` for our runtime, `paper` for the published way, `base` for our runtime
            without what corrects the model, else the name of a peer.
        how: what is called, for people.
        prepare: raw windows (n, f) float32 to what `evaluate` takes; not timed.
        evaluate: what is timed; it gives all 21 channels.
        counts: what `evaluate` gives to counts (n, 21) float32; not timed.
        flops: operations for one window by `taxel_bench.operations`; None where no rule counts them.
        tolerance: standard deviations of a channel by which its counts may differ from ours;
            infinite where it rounds its weights, and None where values are not to be compared.
    """

    name: str
    how: str
    prepare: Callable[[NDArray[np.float32]], Any]
    evaluate: Callable[[Any], Any]
    counts: Callable[[Any], NDArray[np.float32]]
    flops: int | None
    tolerance: float | None = None

    def predict(self, windows: NDArray[np.float32]) -> NDArray[np.float32]:
        """Counts of raw windows, (n, f) to (n, 21)."""
        return self.counts(self.evaluate(self.prepare(windows)))


def taxel_engine(model: LoadedModel, flops: int | None) -> Engine:
    """Our runtime. It takes raw windows and gives counts, so its time includes normalisation."""
    return Engine(TAXEL, _runtime(model), np.ascontiguousarray, model.runtime.evaluate, _channels, flops)


def base_engine(artifact: Artifact, flops: int | None) -> Engine:
    """Our runtime of a corrected model's file, without the effects that correct it.

    It is loaded separately: the two models take turns, and neither finds the other's data in the caches.
    """
    base = artifact.base
    model = LoadedModel(base.manifest, open_runtime(base))
    columns = len(base.manifest.window.features)
    return Engine(
        BASE,
        f"{_runtime(model)}, without effects",
        lambda windows: np.ascontiguousarray(windows[:, :columns]),
        model.runtime.evaluate,
        _channels,
        flops,
    )


def _runtime(model: LoadedModel) -> str:
    kind = "trees" if model.manifest.platform == "xgboost_json" else "networks"
    return f"Taxel's runtime ({kind})"


def _channels(outputs: NDArray[np.float32]) -> NDArray[np.float32]:
    return outputs[:, : len(CHANNELS)]
