"""`bench reload` on a real server."""

import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from taxel_bench.reload.measurement import Loop, Reloads, load_again, reasons_against
from taxel_bench.server_process import running_server_process
from taxel_models.shipped import shipped_repository

QUIET = Loop(10, 0, 0, {}, {})
FLAT = Reloads(QUIET, QUIET, [1.0] * 20, [100.0] * 11 + [130.0] * 10, [9] * 21, [50] * 21)


@pytest.mark.long
def test_a_loop_is_measured_beside_loads(tmp_path: Path) -> None:
    shutil.copytree(shipped_repository() / "ffnn", tmp_path / "ffnn")
    told: list[int] = []
    with running_server_process(tmp_path) as server:
        measured = load_again(server, "ffnn", "lane", 2, 50.0, 0.5, told.append)
    assert told == [1, 2]
    assert len(measured.load_s) == 2
    assert len(measured.memory_mib) == 3
    assert measured.calm.failed == measured.loading.failed == 0
    assert measured.loading.steps >= 25


def test_what_grows_or_fails_is_told() -> None:
    assert reasons_against(FLAT) == []
    grown = replace(FLAT, memory_mib=[100.0] * 20 + [140.0], files=[50] * 20 + [51])
    assert len(reasons_against(grown)) == 2
    assert reasons_against(replace(FLAT, loading=replace(QUIET, failed=1))) == ["1 requests failed"]
