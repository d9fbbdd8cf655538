"""`bench simulator`: its fingertips touch, and its figures are those of its steps."""

import json
from pathlib import Path

import mujoco
import numpy as np
import pytest
from typer.testing import CliRunner

import taxel
import taxel.mujoco
from taxel.local import shipped_repository
from taxel_bench.commands import app
from taxel_bench.simulator.measurement import LEAST_STEPS, TIMESTEP_S, scene


@pytest.mark.parametrize("fingers", [1, 5])
def test_every_fingertip_is_pressed(fingers: int) -> None:
    model = scene(fingers)
    data = mujoco.MjData(model)
    data.ctrl[:] = -np.arange(1, fingers + 1)
    with taxel.load(shipped_repository()) as source:
        tips = taxel.mujoco.Fingertips(model, source.predictor("xgb"))
        for _ in range(500):
            mujoco.mj_step(model, data)
            tips.step(data)
    assert tips.contact is not None
    assert tips.contact.touched.all()
    # Each carries its weight, and the force of its motor, which is turned by 0.2 rad.
    carried = np.arange(1, fingers + 1) / np.cos(0.2) + 0.05 * 9.81
    np.testing.assert_allclose(np.linalg.norm(tips.contact.force, axis=1), carried, rtol=1e-3)


def test_the_command_measures_and_prints_what_it_kept(tmp_path: Path) -> None:
    options = ["simulator", "--fingers", "1,2", "--models", "xgb", "--seconds", "0.1"]
    done = CliRunner().invoke(app, [*options, "--json"])
    assert done.exit_code == 0, done.output
    found = json.loads(done.stdout)
    cells = found["cells"]
    assert [(cell["fingers"], cell["where"]) for cell in cells] == [
        (count, where) for count in (1, 2) for where in ("alone", "local", "remote")
    ]
    for cell in cells:
        assert cell["steps"] >= LEAST_STEPS
        assert cell["real_time_factor"] == pytest.approx(1e6 * TIMESTEP_S / cell["mean_us"])
        assert cell["median_us"] <= cell["p99_us"]
    kept = tmp_path / "kept.json"
    kept.write_text(done.stdout, encoding="utf-8")
    printed = CliRunner().invoke(app, ["simulator", "--of", str(kept)])
    assert len(printed.stdout.splitlines()) == 2 + len(cells)


def test_an_unknown_model_is_told() -> None:
    done = CliRunner().invoke(app, ["simulator", "--fingers", "1", "--models", "thumb"])
    assert done.exit_code == 2
    assert "no model 'thumb'" in done.output
