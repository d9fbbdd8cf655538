"""Examples of loops and simulators run, and what they feel is right."""

import json
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"


def run(name: str, *options: str) -> dict[str, Any]:
    command = [sys.executable, str(EXAMPLES / name), "--json", *options]
    done = subprocess.run(command, capture_output=True, text=True, timeout=900, check=False)
    assert done.returncode == 0, done.stderr
    found: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return found


def test_a_numpy_loop() -> None:
    found = run("numpy_loop.py")
    assert found["resets"] > 64
    # Most of the time they lie on the floor.
    assert found["median_force"] == pytest.approx(found["weight"], rel=0.02)
    assert found["pdc_pressed"] > found["pdc_free"] + 50.0


@pytest.mark.skipif(find_spec("pybullet") is None, reason="pybullet has no wheel for this Python")
@pytest.mark.parametrize("order", [(), ("--finger-first",)])
def test_pybullet(order: tuple[str, ...]) -> None:
    """It stands still, so that the table carries its weight and holds it against the pull."""
    found = run("pybullet_fingertip.py", *order)
    np.testing.assert_allclose(found["velocity"], 0.0, atol=1e-3)
    np.testing.assert_allclose(found["force"], [0.0, -0.2, 0.981], atol=2e-3)
    np.testing.assert_allclose(found["position"], [0.0, 0.0, -0.007], atol=1e-4)
    assert np.abs(found["change"]).max() > 100.0


@pytest.mark.long
@pytest.mark.skipif(find_spec("mujoco") is None, reason="MuJoCo is not installed")
def test_the_loop_in_mujoco_finds_what_the_model_lacks() -> None:
    found = run("loop_in_mujoco.py", "--seconds", "60")
    assert "creep" in found["effects"]
    assert found["error_after"] < 0.6 * found["error_before"]
    # The mean size of normal noise is 0.8 of its standard deviation.
    assert found["error_after"] > 0.7 * found["noise"]
