"""A comparison of Taxel's real server with peers, some of which cannot take part."""

import json
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from typer.testing import CliRunner

from taxel.artifacts import folder_of
from taxel.commands.cli import failing_clearly, new_app
from taxel.errors import SettingsError, Unavailable
from taxel_bench.compare.command import compare
from taxel_bench.compare.comparison import CompareSettings, Comparison, _prepared, run_comparison
from taxel_bench.compare.figures import Figures, Gap
from taxel_bench.compare.peers import parse_peers
from taxel_bench.compare.rounds import BareRuntime, Round
from taxel_bench.compare.servers import taxel_servers
from taxel_models.shipped import shipped_repository

pytestmark = pytest.mark.usefixtures("empty_cache")


@pytest.fixture
def settings() -> CompareSettings:
    """Of the smallest shipped network, where no peer is installed."""
    folder = folder_of(shipped_repository(), "network-b")
    return CompareSettings(
        folder, parse_peers("fastapi,grpc"), install=False, rounds=2, seconds=0.05, seed=1, gaps_ms=(0, 2.5)
    )


def test_ours_is_measured_and_missing_peers_are_named(settings: CompareSettings) -> None:
    comparison = run_comparison(settings, lambda _: None)
    assert list(comparison.skipped) == ["fastapi", "grpc"]
    assert all("not installed: pass --install" in reason for reason in comparison.skipped.values())
    report = json.loads(json.dumps(comparison.report(), allow_nan=False))
    for ours, name in zip(report["results"], ("taxel", "taxel-lane"), strict=True):
        assert ours.pop("server") == name
        gaps = ours.pop("gaps")
        assert list(gaps) == ["0", "2.5"]
        assert all(gap["p99_ms"] >= gap["p50_ms"] > 0 for gap in gaps.values())
        assert all(value >= 0 for value in ours.values())
        assert ours["bulk_p50_ms"] > report["bare_runtime"]["one_p50_ms"] > 0
    assert report["ratios"] == []


def test_wrong_answers_are_not_compared(settings: CompareSettings) -> None:
    with _prepared(settings) as (workload, _):
        wrong = replace(workload, counts=workload.counts + 1)
        with pytest.raises(Unavailable, match="its answers differ by 1"), taxel_servers(wrong):
            pytest.fail("it was let in")


def test_a_server_that_stops_is_told(settings: CompareSettings, monkeypatch: pytest.MonkeyPatch) -> None:
    """A peer without its packages: our own interpreter has no mosec."""
    (mosec,) = parse_peers("mosec")
    monkeypatch.setattr("taxel_bench.compare.comparison.environment", lambda *_, **__: Path(sys.executable))
    comparison = run_comparison(replace(settings, peers=[mosec], rounds=1), lambda _: None)
    assert "No module named 'mosec'" in comparison.skipped["mosec"]


def test_trees_have_no_peers(settings: CompareSettings) -> None:
    with pytest.raises(SettingsError, match="xgboost_json: the peers serve ONNX networks"):
        run_comparison(replace(settings, folder=folder_of(shipped_repository(), "xgb")), lambda _: None)


def test_a_report_has_medians_and_ratios_of_rounds() -> None:
    lane = Figures(1, 10, 90, 10, 1, 2, {"1": Gap(1, 2, 3)})
    slow = Round(
        {
            "fastapi": Figures(8, 80, 10, 80, 8, 8, {"1": Gap(2, 8, 30)}),
            "taxel": Figures(4, 20, 20, 20, 4, 4, {"1": Gap(4, 4, 4)}),
            "taxel-lane": lane,
        },
        BareRuntime(1, 2),
    )
    fast = Round(
        {
            "taxel": Figures(1, 10, 90, 10, 1, 1, {"1": Gap(3, 3, 3)}),
            "taxel-lane": lane,
            "fastapi": Figures(1, 10, 30, 40, 2, 2, {"1": Gap(4, 4, 6)}),
        },
        BareRuntime(3, 4),
    )
    report = Comparison({"fastapi": [slow, fast, fast]}, {"ray": "too large"}).report()
    assert [result["server"] for result in report["results"]] == ["taxel", "taxel-lane", "fastapi"]
    assert report["results"][0]["in_flight_per_s"] == 90
    assert report["results"][0]["gaps"] == {"1": {"p50_ms": 3, "p99_ms": 3, "cpu_us": 3}}
    ratios, lanes = report["ratios"]
    assert lanes["gaps"] == {"1": {"p50_ms": 0.25, "p99_ms": 0.5, "cpu_us": 0.5}}
    assert ratios == {
        "server": "taxel",
        "peer": "fastapi",
        "sequential_p50_ms": 1,
        "sequential_cpu_us": 1,
        "in_flight_per_s": 3,
        "in_flight_cpu_us": 0.25,
        "bulk_p50_ms": 0.5,
        "batch_p50_ms": 0.5,
        "gaps": {"1": {"p50_ms": 0.75, "p99_ms": 0.75, "cpu_us": 0.5}},
    }
    assert report["bare_runtime"] == {"one_p50_ms": 3, "bulk_p50_ms": 4}
    assert report["skipped"] == [{"peer": "ray", "reason": "too large"}]


def test_the_command_prints_and_writes_one_object(tmp_path: Path) -> None:
    app = new_app("Test.")
    app.command("compare")(failing_clearly(compare))
    output = tmp_path / "out.json"
    arguments = ["--peers", "mosec", "--rounds", "1", "--seconds", "0.05", "--json", "-o", str(output)]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    printed = json.loads(result.stdout)
    assert json.loads(output.read_text()) == printed
    assert printed["skipped"][0]["peer"] == "mosec"
    assert CliRunner().invoke(app, ["--peers", "none"]).exit_code == 2
