"""`bench lane` with real servers."""

import json

from typer.testing import CliRunner

from taxel_bench.commands import app
from taxel_bench.lane.measurement import WAYS
from taxel_bench.lane.stages import STAGES


def test_all_ways_and_stages_are_measured() -> None:
    arguments = ["lane", "--rounds", "1", "--seconds", "0.05", "--gap-ms", "0,2", "--json"]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    report = json.loads(result.stdout)
    assert list(report["latency"]) == list(report["stages"]) == ["0", "2"]
    for ways in report["latency"].values():
        assert tuple(ways) == WAYS
        assert all(0 < way["p50_us"] <= way["p99_us"] for way in ways.values())
    for stages in report["stages"].values():
        assert len(stages) == len(STAGES)
        assert min(stages) > 0
