"""The merged model against the 21 it was made of, to the bit."""

import json
from pathlib import Path

import numpy as np
import pytest
import xgboost
from hypothesis import given, settings
from hypothesis import strategies as st

from taxel.errors import ArtifactError
from taxel_models.families.xgb_merge import merge


def fit(
    seed: int, rounds: int, depth: int, objective: str = "reg:absoluteerror", features: int = 6
) -> xgboost.Booster:
    rng = np.random.default_rng(seed)
    windows = rng.normal(size=(300, features)).astype(np.float32)
    target = windows[:, 0] * windows[:, 1] + rng.normal(size=300) * 0.1 + seed
    parameters = {"objective": objective, "max_depth": depth, "nthread": 1, "seed": seed}
    return xgboost.train(parameters, xgboost.DMatrix(windows, target), rounds)


@settings(max_examples=10, deadline=None)
@given(
    st.lists(st.tuples(st.integers(0, 99), st.integers(1, 6), st.integers(1, 5)), min_size=1, max_size=6)
)
def test_every_output_is_bit_identical(shapes: list[tuple[int, int, int]]) -> None:
    boosters = [fit(*shape) for shape in shapes]
    merged = xgboost.Booster()
    merged.load_model(bytearray(merge(boosters)))
    rng = np.random.default_rng(0)
    windows = rng.normal(size=(100, 6)).astype(np.float32)
    windows[rng.random(windows.shape) < 0.1] = np.nan
    found = merged.inplace_predict(windows, missing=np.nan).reshape(100, -1)
    for channel, booster in enumerate(boosters):
        np.testing.assert_array_equal(found[:, channel], booster.inplace_predict(windows, missing=np.nan))


def test_the_merged_file_follows_the_schema() -> None:
    boosters = [fit(0, 3, 2), fit(1, 5, 2), fit(2, 1, 2)]
    model = json.loads(merge(boosters))
    booster = model["learner"]["gradient_booster"]["model"]
    assert booster["tree_info"] == [0, 1, 2, 0, 1, 0, 1, 1, 1]
    assert booster["iteration_indptr"] == [0, 3, 5, 7, 8, 9]
    assert [tree["id"] for tree in booster["trees"]] == list(range(9))
    assert model["learner"]["learner_model_param"]["num_target"] == "3"


@pytest.mark.parametrize(
    ("other", "message"),
    [(fit(1, 2, 2, "reg:squarederror"), "objective"), (fit(1, 2, 2, features=7), "number of features")],
)
def test_models_that_are_not_alike_are_refused(other: xgboost.Booster, message: str) -> None:
    with pytest.raises(ArtifactError, match=f"model 1 has {message}"):
        merge([fit(0, 2, 2), other])


def test_merging_leaves_the_models_as_they_were(tmp_path: Path) -> None:
    booster = fit(0, 2, 2)
    before = booster.save_raw("json")
    merge([booster, fit(1, 3, 2)])
    assert booster.save_raw("json") == before
    (tmp_path / "model.json").write_bytes(merge([booster]))
    assert xgboost.Booster(model_file=tmp_path / "model.json").num_boosted_rounds() == 2
