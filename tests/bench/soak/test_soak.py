"""`bench soak`: what it judges, and a short run against a real server."""

import shutil
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from taxel_bench.server_process import running_server_process
from taxel_bench.soak.clients import Asked
from taxel_bench.soak.measurement import (
    POINTS,
    Moment,
    Soak,
    as_dict,
    bars_of,
    p99_by_interval,
    soak_server,
)
from taxel_bench.soak.plot import draw_soak
from taxel_models.shipped import shipped_repository


def moments(memory_mib: list[float]) -> list[Moment]:
    return [Moment(float(second), memory, 20, 18, 0.5) for second, memory in enumerate(memory_mib)]


def failing(soak: Soak) -> list[str]:
    return [bar.what for bar in bars_of(soak) if not bar.holds]


def test_a_server_that_grows_is_found_out() -> None:
    due = np.linspace(0, 99, 60 * 700).tolist()
    flat = Asked("control loop", due, [1.0] * len(due))
    assert failing(Soak(100.0, moments([300.0] * 100), [flat])) == []
    # What fills in the first tenth is settling.
    assert failing(Soak(100.0, moments([200.0] * 10 + [300.0] * 90), [flat])) == []
    growing = moments([300.0 + second for second in range(100)])
    assert failing(Soak(100.0, growing, [flat])) == ["memory, MiB more than at the beginning"]
    slower = Asked("control loop", due, np.linspace(1, 10, len(due)).tolist(), Counter(INTERNAL=1))
    assert failing(Soak(100.0, moments([300.0] * 100), [slower])) == [
        "control loop: p99, of that at the beginning",
        "requests that failed",
    ]


def test_p99_needs_enough_answers() -> None:
    few = Asked("visitors", [1.0] * 700 + [99.0] * 600, [2.0] * 700 + [3.0] * 600)
    p99 = p99_by_interval(few, 100.0)
    assert p99[0] == pytest.approx(2.0)
    assert np.isfinite(p99).sum() == 1


@pytest.mark.long
def test_a_short_run_against_a_real_server(tmp_path: Path) -> None:
    shutil.copytree(shipped_repository() / "xgb", tmp_path / "repository" / "xgb")
    told: list[float] = []
    with running_server_process(tmp_path / "repository") as server:
        run = soak_server(server, "xgb", 4.0, told.append)
    assert [len(asked.due) > 0 for asked in run.asked] == [True] * 4
    assert told == [moment.seconds for moment in run.moments]
    assert all(moment.memory_mib > 10 and moment.threads > 1 for moment in run.moments)
    assert [len(each["p99_ms"]) for each in as_dict(run)["clients"]] == [POINTS] * 4
    draw_soak(run, tmp_path / "soak.png")
    assert (tmp_path / "soak.png").stat().st_size > 1000
