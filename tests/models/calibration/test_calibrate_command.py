"""`taxel calibrate` from a file to a folder."""

import json
from pathlib import Path

import numpy as np
import pytest
import typer
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

from taxel.commands.cli import failing_clearly
from taxel.skin import height_above_skin
from taxel_models.calibration.misaligned_twin import moved
from taxel_models.calibration.motion import Motion
from taxel_models.commands.calibrate import calibrate
from taxel_models.recordings import read_ruppel, write_ruppel
from taxel_models.twin import simulate


@pytest.fixture(scope="module")
def app() -> typer.Typer:
    app = typer.Typer()
    app.command()(failing_clearly(calibrate))
    return app


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("calibrate") / "run.csv"
    motion = Motion(Rotation.from_rotvec([0.0, 0.1, 0.1]), np.array([2.0, -3.0, 2.0]))
    write_ruppel(moved(simulate(20_000, 1), motion), path)
    return path


def test_a_calibration_is_written_whole(app: typer.Typer, recording: Path, tmp_path: Path) -> None:
    output = tmp_path / "calibration"
    arguments = [str(recording), "-o", str(output), "--rewrite", "--json"]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    printed = json.loads(result.stdout)
    assert printed.pop("output") == str(output)
    assert printed == json.loads((output / "calibration.json").read_text())
    assert printed["distance_mm"]["after"]["mean"] < 0.6 < printed["distance_mm"]["before"]["mean"]
    for name in ("contacts.png", "electrodes.png"):
        assert (output / name).read_bytes().startswith(b"\x89PNG")
    before, after = read_ruppel(recording), read_ruppel(output / "recordings" / "1_run.csv")
    sensor = printed["sensor"]
    rotation = Rotation.from_quat(sensor["quaternion_xyzw"])
    expected = rotation.apply(before.samples.position * 1e3) + sensor["translation_mm"]
    np.testing.assert_allclose(after.samples.position * 1e3, expected, atol=1e-9)
    np.testing.assert_allclose(after.samples.force, rotation.apply(before.samples.force), atol=1e-12)
    np.testing.assert_array_equal(after.channels, before.channels)
    strong = np.linalg.norm(after.samples.force, axis=1) > 2.0
    assert np.abs(height_above_skin(after.samples.position[strong] * 1e3, 7.0)).mean() < 1.5
    refused = CliRunner().invoke(app, arguments)
    assert refused.exit_code == 2
    assert "--overwrite" in refused.stderr


def test_the_table_says_what_cannot_be_told(app: typer.Typer, recording: Path, tmp_path: Path) -> None:
    result = CliRunner().invoke(app, [str(recording), "-o", str(tmp_path / "c"), "--standoff", "0"])
    assert result.exit_code == 0, result.output
    assert "roll is not identifiable" in result.stdout
    assert "given" in result.stdout
    assert not (tmp_path / "c" / "recordings").exists()


def test_a_recording_without_light_contacts_leaves_nothing(app: typer.Typer, tmp_path: Path) -> None:
    write_ruppel(simulate(500, 1), tmp_path / "short.csv")
    result = CliRunner().invoke(app, [str(tmp_path / "short.csv"), "-o", str(tmp_path / "c")])
    assert result.exit_code == 1
    assert "expected at least 20" in result.stderr
    assert not (tmp_path / "c").exists()
