"""The trees runtime against one XGBRegressor a channel: `python -m taxel_bench.trees`."""

import argparse
import json
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Final

import numpy as np
import xgboost
from numpy.typing import NDArray

from taxel.manifest import Normalisation
from taxel_bench.forests import PAPER, SKEWED, ForestShape, write_forest
from taxel_bench.timing import Latencies
from taxel_server.runtimes.trees import TreesRuntime

SHAPES: Final = {"paper": PAPER, "skewed": SKEWED}
ROWS: Final = (1, 8, 64, 1024)

Predict = Callable[[NDArray[np.float32]], NDArray[np.float32]]


def main() -> None:
    """Prints one line a number of rows: medians in ms, and how many times faster than XGBoost."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("shape", choices=SHAPES, nargs="?", default="paper")
    parser.add_argument("--repetitions", type=int, default=30)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "model.json"
        shape = SHAPES[arguments.shape]
        write_forest(path, shape)
        ours, theirs = _runtime(path, shape), _regressors(path, shape)
    print(f"{'rows':>5} {'XGBoost':>9} {'cold':>9} {'':>6} {'warm':>9} {'':>6}")
    for rows in ROWS:
        reference, cold, warm = compare(ours, theirs, shape.features, rows, arguments.repetitions)
        print(f"{rows:5d} {reference:9.2f}", end="")
        print(f" {cold:9.3f} {reference / cold:5.0f}x {warm:9.3f} {reference / warm:5.0f}x")


def compare(
    ours: Predict, theirs: Predict, features: int, rows: int, repetitions: int
) -> tuple[float, float, float]:
    """Median milliseconds: theirs, ours right after theirs (cold caches), and ours by itself (warm).

    Raises:
        AssertionError: the two differ in a single bit.
    """
    windows = np.random.default_rng(rows).standard_normal((repetitions, rows, features), dtype=np.float32)
    seconds = np.empty((repetitions, 2))
    for batch, taken in zip(windows, seconds, strict=True):
        start = time.perf_counter()
        expected = theirs(batch)
        middle = time.perf_counter()
        found = ours(batch)
        taken[:] = middle - start, time.perf_counter() - middle
        np.testing.assert_array_equal(found, expected)
    reference, cold = np.median(seconds, axis=0) * 1e3
    warm = Latencies.of(
        lambda call: ours(windows[call % repetitions]), warm_up=3, repetitions=10 * repetitions
    )
    return float(reference), float(cold), warm.median_ms


def _runtime(path: Path, shape: ForestShape) -> Predict:
    normalisation = Normalisation(
        input_mean=(0.0,) * shape.features,
        input_std=(1.0,) * shape.features,
        output_mean=(0.0,) * shape.outputs,
        output_std=(1.0,) * shape.outputs,
        folded=True,
    )
    return TreesRuntime(path, normalisation).evaluate


def _regressors(path: Path, shape: ForestShape) -> Predict:
    """One model an output, each with its own `predict`: how such forests are usually run."""
    content = json.loads(path.read_text())
    learner = content["learner"]
    model, param = learner["gradient_booster"]["model"], learner["learner_model_param"]
    trees, scores = model["trees"], json.loads(param["base_score"])
    regressors = []
    for output in range(shape.outputs):
        model["trees"] = [tree | {"id": place} for place, tree in enumerate(trees[output :: shape.outputs])]
        count = len(model["trees"])
        model["tree_info"] = [0] * count
        model["iteration_indptr"] = list(range(count + 1))
        model["gbtree_model_param"]["num_trees"] = str(count)
        param.update(base_score=str(scores[output]), num_target="1")
        path.write_text(json.dumps(content))
        regressor = xgboost.XGBRegressor(n_jobs=1)
        regressor.load_model(path)
        regressor.set_params(n_jobs=1)
        regressors.append(regressor)
    return lambda windows: np.stack([regressor.predict(windows) for regressor in regressors], axis=1)


if __name__ == "__main__":
    main()
