"""Whatever the forest and the rows: the same bits as XGBoost's own predictions."""

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest import TestCase

import numpy as np
import pytest
import xgboost
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from taxel.manifest import Normalisation
from taxel_bench.forests import ForestShape, write_forest
from taxel_server.runtimes.trees import TreesRuntime
from taxel_server.runtimes.trees.autotune import Autotuned
from taxel_server.runtimes.trees.normalisation import Scales
from taxel_server.runtimes.trees.reading.xgboost_json import read_forest

Model = Callable[..., dict[str, Any]]
Write = Callable[[dict[str, Any]], Path]
Raw = Callable[..., Normalisation]

ROWS = (1, 2, 5, 16, 33, 64, 130, 300)


def _rows(
    count: int, features: int, generator: np.random.Generator, cuts: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Random rows with missing values, and with values that hit thresholds exactly."""
    rows = generator.normal(size=(count, features)).astype(np.float32)
    hit = generator.random(rows.shape) < 0.3
    rows[hit] = generator.choice(cuts, size=int(hit.sum()))
    rows[generator.random(rows.shape) < 0.1] = np.nan
    return rows


class Evaluators:
    """The runtime for a file, and every evaluator that fits it, chosen or not."""

    def __init__(self, path: Path, normalisation: Normalisation) -> None:
        self._runtime = TreesRuntime(path, normalisation)
        # An evaluator that disagrees on the sample at load is logged, and would not be compared.
        with TestCase().assertNoLogs("taxel_server.runtimes.trees.autotune", "ERROR"):
            found = Autotuned.of(read_forest(path), Scales.of(normalisation))
        self._evaluators = found.evaluators

    def assert_same_bits(self, booster: xgboost.Booster, rows: NDArray[np.float32]) -> None:
        """Compares all of them with XGBoost."""
        expected = booster.inplace_predict(rows, missing=np.nan).reshape(len(rows), -1)
        np.testing.assert_array_equal(self._runtime.evaluate(rows).view(np.int32), expected.view(np.int32))
        for evaluator in self._evaluators:
            found = np.full_like(expected, np.nan)
            evaluator.evaluate(rows, found)
            np.testing.assert_array_equal(
                found.view(np.int32), expected.view(np.int32), err_msg=evaluator.name
            )


@settings(max_examples=6, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    features=st.integers(6, 72),
    rounds=st.integers(1, 4),
    depth=st.integers(0, 8),
    gamma=st.sampled_from([0.0, 1000.0]),
    max_bin=st.sampled_from([8, 64, 300]),
    grow=st.sampled_from(["depthwise", "lossguide"]),
    objective=st.sampled_from(["reg:squarederror", "reg:absoluteerror"]),
)
def test_trained_forests(
    raw: Raw,
    seed: int,
    features: int,
    rounds: int,
    depth: int,
    gamma: float,
    max_bin: int,
    grow: str,
    objective: str,
) -> None:
    generator = np.random.default_rng(seed)
    rows = generator.normal(size=(400, features)).astype(np.float32)
    rows[generator.random(rows.shape) < 0.05] = np.nan
    targets = _targets(rows, generator)
    booster = xgboost.train(
        {
            "objective": objective,
            "max_depth": depth,
            "max_leaves": 300 if depth == 0 else 0,
            "max_bin": max_bin,
            "grow_policy": grow,
            "nthread": 1,
            "gamma": gamma,
            "tree_method": "hist",
        },
        xgboost.DMatrix(rows, targets),
        rounds,
    )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "model.json"
        booster.save_model(path)
        evaluators = Evaluators(path, raw(features))
    for count in ROWS:
        evaluators.assert_same_bits(booster, rows[generator.integers(0, len(rows), count)])


def _targets(rows: NDArray[np.float32], generator: np.random.Generator) -> NDArray[np.float32]:
    clean = np.nan_to_num(rows)
    return (np.sin(clean @ generator.normal(size=(rows.shape[1], 21))) * 350).astype(np.float32)


@pytest.mark.parametrize(
    "shape",
    [
        ForestShape(features=6, trees_per_output=1, leaves=1),
        ForestShape(features=6, trees_per_output=3, leaves=2, depth=1),
        ForestShape(features=12, trees_per_output=20, leaves=40),
        ForestShape(features=12, outputs=1, trees_per_output=300, leaves=40),
        ForestShape(features=72, trees_per_output=20, leaves=90, cuts=60),
        ForestShape(features=72, trees_per_output=30, leaves=90, cuts=700),
        ForestShape(features=12, trees_per_output=4, leaves=60, depth=60, skew=1.0),
        ForestShape(features=12, trees_per_output=4, leaves=127, depth=127, skew=0.9),
        ForestShape(features=12, trees_per_output=4, leaves=128, depth=20, skew=0.2),
        ForestShape(features=12, trees_per_output=3, leaves=900, depth=40, skew=0.3),
        ForestShape(features=12, trees_per_output=2, leaves=900, depth=900, skew=1.0, cuts=2000),
        ForestShape(features=7, outputs=2, trees_per_output=1, leaves=36000, depth=40, skew=0.0, cuts=5000),
    ],
    ids=str,
)
def test_random_forests(tmp_path: Path, raw: Raw, shape: ForestShape) -> None:
    path = tmp_path / "model.json"
    write_forest(path, shape, seed=5)
    evaluators = Evaluators(path, raw(shape.features, shape.outputs))
    booster = xgboost.Booster(model_file=path)
    generator = np.random.default_rng(1)
    cuts = read_forest(path).value
    for count in ROWS:
        evaluators.assert_same_bits(booster, _rows(count, shape.features, generator, cuts))


EXTREMES = [-np.inf, -3.4e38, -1.0, -1e-45, -0.0, 0.0, 1e-45, 1.0, 3.4e38, np.inf, np.nan]


@pytest.mark.parametrize("default_left", [True, False])
@pytest.mark.parametrize("threshold", [value for value in EXTREMES if not np.isnan(value)])
def test_extreme_inputs_and_thresholds(
    model: Model, write: Write, raw: Raw, threshold: float, default_left: bool
) -> None:
    # XGBoost refuses infinite inputs at the door, so the rule itself is the reference here.
    tree = (2, float(np.float32(threshold)), default_left, (1.0,), (2.0,))
    runtime = TreesRuntime(write(model([tree, (0.5,)])), raw(6, 1))
    rows = np.zeros((len(EXTREMES), 6), dtype=np.float32)
    rows[:, 2] = EXTREMES
    left = np.where(np.isnan(rows[:, 2]), default_left, rows[:, 2] < np.float32(threshold))
    expected = np.where(left, np.float32(1.0), np.float32(2.0)) + np.float32(1.0)
    np.testing.assert_array_equal(runtime.evaluate(rows)[:, 0], expected)
    for row, value in zip(rows, expected, strict=True):
        assert runtime.evaluate(row[None])[0, 0] == value


def test_sums_keep_the_order_of_the_trees(model: Model, write: Write, raw: Raw) -> None:
    leaves = np.random.default_rng(3).normal(size=210) * 10.0 ** np.random.default_rng(4).integers(
        -6, 6, 210
    )
    path = write(
        model(
            [(float(leaf),) for leaf in leaves.astype(np.float32)],
            outputs=21,
            base_score="[" + ",".join(["0.1"] * 21) + "]",
        )
    )
    booster = xgboost.Booster(model_file=path)
    Evaluators(path, raw(6)).assert_same_bits(booster, np.zeros((70, 6), dtype=np.float32))
