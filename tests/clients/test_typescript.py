"""The client for Node: its own tests hold it against the golden messages and against real servers."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

CLIENT = Path(__file__).resolve().parents[2] / "clients" / "typescript"
OLDEST_NODE = 20


def test_its_own_tests_pass() -> None:
    node, npm = shutil.which("node"), shutil.which("npm")
    if node is None or npm is None:
        pytest.skip("no Node on this machine")
    version = subprocess.run([node, "--version"], capture_output=True, text=True, check=True).stdout
    if int(version.lstrip("v").partition(".")[0]) < OLDEST_NODE:
        pytest.skip(f"Node {version.strip()} is too old: the client needs {OLDEST_NODE}")
    if not (CLIENT / "node_modules" / "typescript").is_dir():
        pytest.skip("no TypeScript compiler: run npm ci in clients/typescript")
    environment = {**os.environ, "TAXEL_PYTHON": sys.executable}
    done = subprocess.run(
        [npm, "test"], cwd=CLIENT, env=environment, capture_output=True, text=True, timeout=600, check=False
    )
    assert done.returncode == 0, f"{done.stdout}\n{done.stderr}"
