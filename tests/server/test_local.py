"""Prediction in this process."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import xgboost
from numpy.typing import NDArray

import taxel
import taxel.scaling
import taxel_server.engine
from taxel.errors import InvalidArgument, NotFound, Unavailable
from taxel.windows.checks import LARGEST

WindowMaker = Callable[..., NDArray[np.float32]]


def test_predictions_are_the_trained_models(repository: Path, make_windows: WindowMaker) -> None:
    booster = xgboost.Booster(model_file=repository / "wide" / "1" / "model.json")
    with taxel.load(repository) as source:
        predictor = source.predictor("wide")
        windows = make_windows(50, 12)
        scaling = predictor.manifest.normalisation
        inputs = taxel.scaling.Scaler.of(scaling.input_mean, scaling.input_std)
        outputs = taxel.scaling.Scaler.of(scaling.output_mean, scaling.output_std)
        expected = outputs.restore(booster.inplace_predict(inputs.normalise(windows)))
        np.testing.assert_allclose(predictor.predict(windows), expected, rtol=1e-6)


def test_the_largest_values_that_are_taken_give_numbers() -> None:
    with taxel.load() as source:
        for model in source.models():
            predictor = source.predictor(model.name, model.version)
            signs = np.random.default_rng(0).choice(
                [-1.0, 1.0], (40, len(predictor.manifest.window.features))
            )
            assert np.isfinite(predictor.predict(LARGEST * signs)).all()
            assert np.isfinite(predictor.predict(LARGEST * signs[:1])).all()
            with pytest.raises(InvalidArgument, match="expected a finite number, at most 1e"):
                predictor.predict(1.01 * LARGEST * signs)


def test_other_number_types_and_layouts_are_taken(repository: Path, make_windows: WindowMaker) -> None:
    with taxel.load(repository) as source:
        predictor = source.predictor("skin")
        windows = make_windows(9)
        expected = predictor.predict(windows)
        read_only = windows.copy()
        read_only.flags.writeable = False
        for same in (windows.astype(np.float64), np.asfortranarray(windows), read_only):
            np.testing.assert_array_equal(predictor.predict(same), expected)


def test_only_what_is_asked_for_is_loaded(repository: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    opened = []
    opening = taxel_server.engine.open_runtime

    def note(artifact: taxel.artifacts.Artifact, threads: int) -> object:
        opened.append(f"{artifact.manifest.name}/{artifact.manifest.version}")
        return opening(artifact, threads)

    monkeypatch.setattr(taxel_server.engine, "open_runtime", note)
    with taxel.load(repository) as source:
        assert [model.state for model in source.models()] == ["READY"] * 3
        assert opened == []
        source.predictor("skin")
        source.predictor("skin")
    assert opened == ["skin/10"]


def test_wrong_windows_are_refused(repository: Path, make_windows: WindowMaker) -> None:
    with taxel.load(repository) as source:
        predictor = source.predictor("skin")
        with pytest.raises(InvalidArgument, match=r"shape \(2, 7\): expected \(n, 6\)"):
            predictor.predict(make_windows(2, 7))
        with pytest.raises(InvalidArgument, match=r"window\[0, 'x'\] is nan"):
            predictor.predict(np.full((1, 6), np.nan))


def test_what_is_not_there_is_not_found(repository: Path) -> None:
    with taxel.load(repository) as source, pytest.raises(NotFound):
        source.predictor("finger")


def test_a_closed_source_and_its_predictors_stop(repository: Path, make_windows: WindowMaker) -> None:
    source = taxel.load(repository)
    predictor = source.predictor("skin")
    source.close()
    with pytest.raises(Unavailable, match="closed"):
        predictor.predict(make_windows(1))
    with pytest.raises(Unavailable, match="closed"):
        source.models()
