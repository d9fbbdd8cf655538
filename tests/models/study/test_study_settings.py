"""Which settings are accepted, and what a cell's key depends on."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from taxel.errors import SettingsError
from taxel_models.recordings import Recording
from taxel_models.study.published import ROWS, TDC_SUM, is_published_data
from taxel_models.study.reduction import reduce_rows
from taxel_models.study.study_settings import Cell, StudySettings, parse_combinations, parse_overrides

Make = Callable[..., Recording]


def test_combinations_are_read_as_numbers_and_ranges() -> None:
    assert parse_combinations("1-8") == tuple(range(1, 9))
    assert parse_combinations("1, 3,5-7") == (1, 3, 5, 6, 7)


@pytest.mark.parametrize("text", ["", "a", "1-", "-3", "1,,2", "1-b"])
def test_combinations_that_are_none_are_refused(text: str) -> None:
    with pytest.raises(SettingsError, match="--inputs"):
        parse_combinations(text)


def test_overrides_go_to_their_model() -> None:
    found = parse_overrides({"xgb.eta": 0.1, "xgb.gamma": 2, "ffnn.epochs": 3})
    assert found == {"xgb": {"eta": 0.1, "gamma": 2}, "ffnn": {"epochs": 3}}


@pytest.mark.parametrize("name", ["eta", "xgb.", ".eta", "tree.eta"])
def test_an_override_without_a_model_is_refused(name: str) -> None:
    with pytest.raises(SettingsError, match=r"expected MODEL\.NAME"):
        parse_overrides({name: 1})


@pytest.mark.parametrize(
    ("wrong", "text"),
    [
        ({"models": ("xgb", "tree")}, "models xgb, tree"),
        ({"models": ()}, "none"),
        ({"combinations": (1, 9)}, "inputs 1, 9"),
        ({"combinations": (1, 1)}, "each once"),
        ({"folds": 1}, "at least 2"),
        ({"models": ("xgb",), "overrides": {"ffnn": {"epochs": 1}}}, "none of the models"),
    ],
)
def test_a_plan_that_cannot_be_is_refused(wrong: dict[str, Any], text: str) -> None:
    with pytest.raises(SettingsError, match=text):
        StudySettings(**wrong)


def test_an_unknown_hyperparameter_is_refused() -> None:
    with pytest.raises(SettingsError, match="depth"):
        StudySettings(models=("xgb",), overrides={"xgb": {"depth": 3}}).check()


def test_a_full_study_has_320_cells_a_protocol() -> None:
    cells = StudySettings(protocols=("strict", "paper")).cells()
    assert len(cells) == len(set(cells)) == 2 * 4 * 8 * 10


def test_the_key_tells_everything_that_matters_apart() -> None:
    settings = StudySettings(models=("xgb", "ffnn"), combinations=(1, 2))
    cell = Cell("strict", 1, 0, "xgb")
    keys = [
        settings.key(cell, ["a"], "chunks"),
        settings.key(cell, ["b"], "chunks"),
        settings.key(cell, ["a", "b"], "chunks"),
        settings.key(cell, ["a"], "trials"),
        *(
            settings.key(replace(cell, **other), ["a"], "chunks")
            for other in (  # type: ignore[arg-type]
                {"protocol": "paper"},
                {"combination": 2},
                {"fold": 1},
                {"model": "ffnn"},
            )
        ),
        *(
            replace(settings, **other).key(cell, ["a"], "chunks")
            for other in (  # type: ignore[arg-type]
                {"folds": 9},
                {"rows": 5},
                {"seed": 1},
                {"overrides": {"xgb": {"eta": 0.2}}},
            )
        ),
    ]
    assert len(set(keys)) == len(keys)
    assert settings.key(cell, ["a"], "chunks") == keys[0]
    # What else is studied is nothing to this cell.
    assert replace(settings, models=("xgb",), combinations=(1,)).key(cell, ["a"], "chunks") == keys[0]


def test_a_reduction_keeps_whole_units(make_recording: Make) -> None:
    recordings = [make_recording([100] * 30, 1), make_recording([90] * 30, 2)]
    kept = reduce_rows(recordings, "trials", 1000, 3)
    lengths = [segment.stop - segment.start for recording in kept for segment in recording.segments]
    assert set(lengths) == {100, 90}
    assert 1000 <= sum(lengths) < 1100
    again = reduce_rows(recordings, "trials", 1000, 3)
    np.testing.assert_array_equal(kept[0].channels, again[0].channels)
    assert reduce_rows(recordings, "trials", None, 3) == recordings


def test_a_reduction_to_more_than_there_is_is_refused(make_recording: Make) -> None:
    with pytest.raises(SettingsError, match="expected 1 to 500"):
        reduce_rows([make_recording([500])], "chunks", 501, 0)


def test_the_papers_data_are_known_by_rows_and_temperature(make_recording: Make) -> None:
    recording = make_recording([ROWS])
    tdc = np.full(ROWS, TDC_SUM // ROWS, float)
    tdc[: TDC_SUM % ROWS] += 1
    genuine = replace(recording, auxiliary={**recording.auxiliary, "tdc": tdc})
    assert is_published_data([genuine])
    assert not is_published_data([recording])
    assert not is_published_data([genuine, genuine])
    assert not is_published_data([genuine.rows(slice(0, ROWS - 1))])
