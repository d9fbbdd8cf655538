"""The published way for trees: one XGBRegressor for each channel, one after another, in one thread."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import xgboost
from numpy.typing import NDArray

from taxel.manifest import Manifest
from taxel.scaling import Scaler
from taxel_bench.engines import PUBLISHED, THREADS, Engine
from taxel_bench.operations.of_trees import count_tree_operations, leaf_depths


class Regressors:
    """Splits a merged forest into its boosters, without loss.

    The inverse of `taxel_models.families.xgb_merge`.

    Args:
        model_path: XGBoost's JSON of a model with one output a tree.
        manifest: the artifact's.
    """

    def __init__(self, model_path: Path, manifest: Manifest) -> None:
        model = json.loads(model_path.read_bytes())
        forest = model["learner"]["gradient_booster"]["model"]
        trees, outputs = forest["trees"], forest["tree_info"]
        scores = model["learner"]["learner_model_param"]["base_score"].strip("[]").split(",")
        self._models: list[tuple[xgboost.XGBRegressor, list[NDArray[np.int64]]]] = []
        for output, score in enumerate(scores):
            own = [tree for tree, place in zip(trees, outputs, strict=True) if place == output]
            depths = [leaf_depths(tree) for tree in own]
            self._models.append((_regressor(model, own, score), depths))
        self._manifest = manifest

    @property
    def boosters(self) -> tuple[xgboost.Booster, ...]:
        """One booster for each channel."""
        return tuple(regressor.get_booster() for regressor, _ in self._models)

    def engine(self, windows: NDArray[np.float32]) -> Engine:
        """Each regressor's `predict` in turn: z-scores in and out, as the published script had them.

        Args:
            windows: (n, f) raw, over which operations are averaged.
        """
        statistics = self._manifest.normalisation
        inputs = Scaler.of(statistics.input_mean, statistics.input_std)
        outputs = Scaler.of(statistics.output_mean, statistics.output_std)
        regressors = [regressor for regressor, _ in self._models]
        return Engine(
            PUBLISHED,
            f"{len(regressors)} x XGBRegressor.predict, XGBoost {xgboost.__version__}",
            inputs.normalise,
            lambda windows: [regressor.predict(windows) for regressor in regressors],
            lambda columns: outputs.restore(np.stack(columns, axis=1)),
            self._operations(inputs.normalise(windows)),
            tolerance=0.0,
        )

    def _operations(self, windows: NDArray[np.float32]) -> int:
        """Comparisons and additions for one window, the mean over z-scored ones (n, f)."""
        counts = []
        for regressor, depths in self._models:
            # Of a single tree, XGBoost gives a flat array.
            leaves = regressor.apply(windows).astype(np.int64).reshape(len(windows), len(depths))
            counts.append(count_tree_operations(depths, leaves))
        return round(sum(counts))


def _regressor(model: dict[str, Any], trees: list[dict[str, Any]], score: str) -> xgboost.XGBRegressor:
    """A regressor with these trees; `model` is written over, its trees apart."""
    learner = model["learner"]
    forest = learner["gradient_booster"]["model"]
    forest["trees"] = [tree | {"id": place} for place, tree in enumerate(trees)]
    forest["tree_info"] = [0] * len(trees)
    forest["iteration_indptr"] = list(range(len(trees) + 1))
    forest["gbtree_model_param"]["num_trees"] = str(len(trees))
    learner["learner_model_param"].update(base_score=score.strip(), num_target="1")
    regressor = xgboost.XGBRegressor(n_jobs=THREADS)
    regressor.load_model(bytearray(json.dumps(model, separators=(",", ":")).encode()))
    # Loading replaces the number of threads.
    regressor.set_params(n_jobs=THREADS)
    return regressor
