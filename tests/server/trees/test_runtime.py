"""The runtime as the engine uses it."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xgboost

from taxel.errors import ArtifactError
from taxel.manifest import Normalisation
from taxel.scaling import Scaler
from taxel_server.runtimes.trees import TreesRuntime

STUMP = (0, 0.25, True, (1.5,), (-2.5,))
Model = Callable[..., dict[str, Any]]
Write = Callable[[dict[str, Any]], Path]
Raw = Callable[..., Normalisation]


@pytest.mark.parametrize("folded", [False, True])
def test_windows_are_normalised_and_outputs_restored(model: Model, write: Write, folded: bool) -> None:
    generator = np.random.default_rng(0)
    trees = [
        (3, float(cut), True, (float(cut),), (-1.25,))
        for cut in generator.normal(size=42).astype(np.float32)
    ]
    path = write(model(trees, outputs=21))
    normalisation = Normalisation(
        input_mean=tuple(generator.normal(size=6)),
        input_std=tuple(generator.uniform(0.5, 2, size=6)),
        output_mean=tuple(generator.normal(size=21)),
        output_std=tuple(generator.uniform(0.5, 2, size=21)),
        folded=folded,
    )
    windows = generator.normal(size=(50, 6)).astype(np.float32)
    booster = xgboost.Booster(model_file=path)
    inputs = Scaler.of(normalisation.input_mean, normalisation.input_std)
    outputs = Scaler.of(normalisation.output_mean, normalisation.output_std)
    if folded:
        expected = booster.inplace_predict(windows)
    else:
        expected = outputs.restore(booster.inplace_predict(inputs.normalise(windows)))
    found = TreesRuntime(path, normalisation).evaluate(windows)
    np.testing.assert_array_equal(found, expected)


def test_it_says_what_it_holds(model: Model, write: Write, raw: Raw) -> None:
    runtime = TreesRuntime(write(model([STUMP] * 21, outputs=21)), raw(6))
    assert runtime.features == 6


@pytest.mark.parametrize(
    ("features", "outputs", "says"), [(7, 1, "6 inputs: expected 7"), (6, 21, "1 outputs: expected 21")]
)
def test_a_model_at_odds_with_its_normalisation_is_refused(
    model: Model, write: Write, raw: Raw, features: int, outputs: int, says: str
) -> None:
    path = write(model([STUMP]))
    with pytest.raises(ArtifactError, match=says):
        TreesRuntime(path, raw(features, outputs))


@pytest.mark.parametrize("threads", [1, 3])
def test_calls_from_many_threads_do_not_disturb_each_other(
    model: Model, write: Write, raw: Raw, threads: int
) -> None:
    trees = [(output % 6, 0.01 * output, True, STUMP, (2.0 + output,)) for output in range(63)]
    path = write(model(trees, outputs=21))
    runtime = TreesRuntime(path, raw(6), threads=threads)
    booster = xgboost.Booster(model_file=path)
    generator = np.random.default_rng(0)
    batches = [generator.normal(size=(rows, 6)).astype(np.float32) for rows in [1, 7, 40, 333, 1100] * 20]
    with ThreadPoolExecutor(4) as pool:
        for found, batch in zip(pool.map(runtime.evaluate, batches), batches, strict=True):
            np.testing.assert_array_equal(found, booster.inplace_predict(batch))


def test_no_rows_give_no_rows(model: Model, write: Write, raw: Raw) -> None:
    runtime = TreesRuntime(write(model([STUMP] * 21, outputs=21)), raw(6))
    assert runtime.evaluate(np.empty((0, 6), dtype=np.float32)).shape == (0, 21)
