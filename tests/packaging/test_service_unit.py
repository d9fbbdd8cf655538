"""The systemd unit, read by systemd's own tool where there is one."""

import re
import shutil
import subprocess
import sys
import tomllib
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


def test_the_image_is_built_from_files_and_an_extra_that_exist() -> None:
    text = (UNIT.parent / "Containerfile").read_text()
    root = UNIT.parents[1]
    copied = [
        source
        for line in re.findall(r"^COPY (?!--)(.*)$", text, re.MULTILINE)
        for source in line.split()[:-1]
    ]
    assert all((root / source).exists() for source in copied), copied
    project = tomllib.loads((root / "pyproject.toml").read_text())
    wheel = project["tool"]["hatch"]["build"]["targets"]["wheel"]
    needed = [*wheel["packages"], *wheel["force-include"], "README.md", "LICENSE", "pyproject.toml"]
    for path in needed:
        assert any(Path(path).is_relative_to(source) for source in copied), f"{path} is not copied"
    (extras,) = re.findall(r"'\.\[([a-z,]+)\]'", text)
    assert set(extras.split(",")) <= set(project["project"]["optional-dependencies"])
