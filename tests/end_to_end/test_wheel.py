"""The wheel alone, in an environment of its own: it serves and predicts."""

import json
import os
import subprocess
import sys
import venv
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]

SERVE_AND_PREDICT = """
import json, sys
import numpy as np, taxel
from taxel_bench.server_process import running_server
from taxel_models.shipped import shipped_repository

repository = shipped_repository()
assert sys.prefix in str(repository), repository
windows = np.zeros((3, 12), np.float32)
with running_server(repository) as endpoint, taxel.connect(endpoint) as server:
    remote = server.predictor("xgb").predict(windows)
with taxel.load(repository) as local:
    assert (remote == local.predictor("xgb").predict(windows)).all()
missing = [name for name in ("torch", "xgboost", "pandas", "scipy", "matplotlib") if name in sys.modules]
print(json.dumps({"shape": remote.shape, "loaded": missing, "from": taxel.__file__}))
"""


@pytest.fixture(scope="module")
def environment(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A new virtual environment with nothing but the wheel and what it declares for serving."""
    folder = tmp_path_factory.mktemp("wheel")
    build = [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", str(folder), str(ROOT)]
    subprocess.run(build, check=True, capture_output=True)
    (wheel,) = folder.glob("taxel-*.whl")
    venv.create(folder / "venv", with_pip=True)
    install = [
        "-m",
        "pip",
        "--disable-pip-version-check",
        "install",
        "-q",
        "-c",
        str(ROOT / "constraints.txt"),
    ]
    subprocess.run([folder / "venv" / "bin" / "python", *install, f"{wheel}[server]"], check=True)
    return folder / "venv"


def run(environment: Path, *command: str) -> subprocess.CompletedProcess[str]:
    clean = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "TAXEL"))}
    program = str(environment / "bin" / command[0])
    return subprocess.run(
        [program, *command[1:]], capture_output=True, text=True, env=clean, cwd=environment, timeout=300
    )


def test_the_wheel_serves_and_predicts(environment: Path) -> None:
    done = run(environment, "python", "-c", SERVE_AND_PREDICT)
    assert done.returncode == 0, done.stderr
    said = json.loads(done.stdout)
    assert said["shape"] == [3, 21]
    assert said["loaded"] == []
    assert said["from"].startswith(str(environment))


def test_the_wheel_runs_the_demo(environment: Path) -> None:
    done = run(environment, "taxel", "demo", "--seconds", "1", "--rows", "200", "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["rows"] == 180


def test_what_is_not_installed_is_said_plainly(environment: Path) -> None:
    done = run(environment, "taxel", "train", "--data", "x.csv", "-o", "out")
    assert done.returncode == 1
    assert "pip install 'taxel[all]'" in done.stderr
    assert "Traceback" not in done.stderr
