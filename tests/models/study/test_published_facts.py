"""The twin beside the published data set."""

import json
from typing import Any

import pytest
import typer
from typer.testing import CliRunner

from taxel.artifacts import folder_of, read
from taxel.channels import CHANNELS
from taxel.commands.cli import failing_clearly
from taxel.errors import SettingsError
from taxel_models.shipped import shipped_repository
from taxel_models.study.published import ROWS
from taxel_models.study.published_facts import Fact, main, model_facts, recording_facts, within
from taxel_models.twin import simulate


def by_name(facts: list[Fact], start: str) -> Fact:
    (found,) = [fact for fact in facts if fact.name.startswith(start)]
    return found


def metrics(errors: dict[str, float]) -> dict[str, Any]:
    """Held-out errors with these normalised ones by channel, 0.2 for the others."""
    norm = {name: errors.get(name, 0.2) for name in CHANNELS}
    electrodes = [value for name, value in norm.items() if name.startswith("e")]
    figures = {
        "mae": 20.0,
        "mae_electrodes": 20.0,
        "norm_mae": sum(norm.values()) / len(norm),
        "norm_mae_electrodes": sum(electrodes) / len(electrodes),
        "per_channel": {name: {"norm_mae": value} for name, value in norm.items()},
    }
    return {
        "test_mean_temperature": figures,
        "test_measured_temperature": {**figures, "norm_mae": figures["norm_mae"] - 0.1},
        "mean_predictor": {"norm_mae": 0.5},
    }


def test_a_fact_is_met_within_its_range() -> None:
    assert [within("", 10, 2, twin).met for twin in (7.9, 8, 12, 12.1)] == [False, True, True, False]
    assert [Fact("", "", None, 3, twin).met for twin in (-9, 3, 4)] == [True, True, False]
    assert [Fact("", "", 3, None, twin).met for twin in (2, 3, 99)] == [False, True, True]


def test_hard_tip_electrodes_are_found() -> None:
    tip = {"e7": 0.4, "e8": 0.3, "e9": 0.5, "e10": 0.4}
    facts = model_facts(metrics(tip))
    assert by_name(facts, "e7 to e10").met
    assert by_name(facts, "error of e7").twin == pytest.approx(2.0)
    facts = model_facts(metrics({**tip, "e10": 0.1, "pdc": 0.6}))
    assert by_name(facts, "e7 to e10").twin == 3
    assert not by_name(facts, "e7 to e10").met


def test_what_the_temperature_and_the_fluids_channels_are_worth() -> None:
    facts = model_facts(metrics({"pac0": 0.1, "pdc": 0.2}))
    assert by_name(facts, "relative loss").twin == pytest.approx(0.1 / 0.5)
    assert by_name(facts, "normalised MAE of pac0").twin == pytest.approx(0.15 / 0.2)
    assert by_name(facts, "MAE of pac0").twin == pytest.approx(1.0)
    # 21 channels err by 18.977 counts in the published mean and the 19 electrodes by 17.147.
    assert by_name(facts, "MAE of pac0").published == pytest.approx(36.362 / 17.147, abs=1e-3)


def test_a_model_without_temperature_has_no_such_facts() -> None:
    with pytest.raises(SettingsError, match="measured and mean temperature"):
        model_facts({"test": {}, "mean_predictor": {}})


def test_a_twin_as_long_as_the_published_recording_matches_it() -> None:
    facts = recording_facts(simulate(ROWS, 7))
    assert [fact.name for fact in facts if not fact.met] == []


def test_the_shipped_network_errs_as_the_papers_does() -> None:
    training = read(folder_of(shipped_repository(), "network-b")).manifest.training
    assert training is not None
    facts = model_facts(training.metrics)
    assert [fact.name for fact in facts if not fact.met] == []


def test_the_command_tells_what_a_short_twin_lacks() -> None:
    app = typer.Typer()
    app.command()(failing_clearly(main))
    result = CliRunner().invoke(app, ["--rows", "20000", "--seed", "3", "--json"])
    assert result.exit_code == 0, result.output
    told = json.loads(result.stdout)
    found = {fact["name"]: fact for fact in told["facts"]}
    assert not found["tdc, mean of the last second"]["met"]
    assert found["tdc, mean of the first second"]["met"]
    shipped = read(folder_of(shipped_repository(), "network-b")).manifest.training
    assert shipped is not None
    measured = shipped.metrics["test_measured_temperature"]["norm_mae"]
    assert found["normalised MAE, temperature measured"]["twin"] == measured
    refused = CliRunner().invoke(app, ["--model", str(folder_of(shipped_repository(), "xgb"))])
    assert refused.exit_code == 2
