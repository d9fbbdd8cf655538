"""The systemd unit, read by systemd's own tool where there is one."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from typer.main import get_command

from taxel.commands.cli import build

UNIT = Path(__file__).resolve().parents[2] / "packaging" / "taxel.service"


def test_systemd_finds_no_fault_in_the_unit(tmp_path: Path) -> None:
    if (systemd := shutil.which("systemd-analyze")) is None:
        pytest.skip("systemd-analyze is not here")
    placed = tmp_path / "taxel.service"
    placed.write_text(UNIT.read_text().replace("/opt/taxel/bin/taxel", sys.executable))
    done = subprocess.run([systemd, "verify", placed], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")


def test_the_unit_and_the_image_name_options_that_exist() -> None:
    serve = get_command(build()).commands["serve"]  # type: ignore[attr-defined]
    known = {option for parameter in serve.params for option in parameter.opts}
    texts = UNIT.read_text() + (UNIT.parent / "Containerfile").read_text().partition("ENTRYPOINT")[2]
    used = set(re.findall(r"--[a-z-]+", texts))
    assert used
    assert used <= known
    fields = {f"TAXEL_{option[2:].replace('-', '_').upper()}" for option in known}
    assert set(re.findall(r"TAXEL_[A-Z_]+", (UNIT.parent / "Containerfile").read_text())) <= fields
