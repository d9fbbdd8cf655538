"""The `taxel` command line: groups of commands, and what it says of missing packages."""

import os
import subprocess
import sys
from collections.abc import Callable
from importlib.metadata import EntryPoint, entry_points, metadata

import pytest
import typer
from packaging.requirements import Requirement
from typer.testing import CliRunner

from taxel.commands import cli
from taxel.dependencies import SERVING, require
from taxel.errors import MissingDependency


def app_of(command: Callable[..., None]) -> typer.Typer:
    app = typer.Typer()
    app.command()(cli.failing_clearly(command))
    return app


def test_bench_is_a_group_of_taxel_and_a_command_of_its_own() -> None:
    done = CliRunner().invoke(cli.build(), ["bench", "--help"])
    assert done.exit_code == 0, done.output
    for name in ("run", "table", "load", "compare"):
        assert name in done.output
    wrong = CliRunner().invoke(cli.build(), ["bench", "load", "--scenario", "nowhere", "--model", "xgb"])
    assert wrong.exit_code == 2
    assert "nowhere" in wrong.stderr
    alone = [sys.executable, "-m", "taxel_bench", "--help"]
    assert "compare" in subprocess.run(alone, capture_output=True, text=True, check=True).stdout


@pytest.mark.parametrize("encoding", ["ascii", "latin1"])
def test_help_is_printed_in_any_encoding(encoding: str) -> None:
    command = [sys.executable, "-m", "taxel", "serve", "--help"]
    environment = os.environ | {"PYTHONIOENCODING": encoding}
    done = subprocess.run(command, capture_output=True, env=environment, check=True)
    assert b"--repository" in done.stdout
    assert not done.stderr


def test_a_command_that_cannot_be_loaded_harms_no_other(monkeypatch: pytest.MonkeyPatch) -> None:
    entries = [
        EntryPoint("lost", "taxel_nowhere:lost", cli.COMMANDS),
        *entry_points(group=cli.COMMANDS, name="models"),
    ]
    monkeypatch.setattr(cli, "entry_points", lambda group: entries)
    done = CliRunner().invoke(cli.build(), ["lost"])
    assert done.exit_code == 1
    assert "the command lost (taxel_nowhere:lost) cannot be loaded" in done.stderr
    assert "--connect" in CliRunner().invoke(cli.build(), ["models", "--help"]).output


def test_what_a_command_needs_is_checked_before_it_begins(monkeypatch: pytest.MonkeyPatch) -> None:
    began = []

    @cli.needs("loop", "scipy", "numpy", "taxel_nowhere")
    def command() -> None:
        began.append(True)

    monkeypatch.setitem(sys.modules, "scipy", None)
    done = CliRunner().invoke(app_of(command))
    assert (done.exit_code, began) == (1, [])
    assert "needs scipy, taxel_nowhere: pip install 'taxel[loop]'" in done.stderr.replace("\n", " ")


def test_a_package_that_is_missing_later_is_told_with_the_same_extra() -> None:
    @cli.needs("train", "numpy")
    def command() -> None:
        raise ModuleNotFoundError("No module named 'torch'", name="torch")

    done = CliRunner().invoke(app_of(command))
    assert done.exit_code == 1
    assert "needs torch: pip install 'taxel[train]'" in done.stderr.replace("\n", " ")


def test_what_serving_needs_is_in_its_extra_and_is_here() -> None:
    require("serving", "server", *SERVING)
    required = [Requirement(line) for line in metadata("taxel").get_all("Requires-Dist") or ()]
    server = [each for each in required if each.marker and "'server'" in str(each.marker).replace('"', "'")]
    # A package may stand twice, with a lower bound of its own on ARM.
    assert {each.name.replace("-", "_") for each in server} == set(SERVING)
    with pytest.raises(
        MissingDependency, match=r"^drawing needs taxel_nowhere: pip install 'taxel\[plot\]'$"
    ):
        require("drawing", "plot", "numpy", "taxel_nowhere")
    with pytest.raises(MissingDependency, match=r"needs taxel_nowhere\.part: pip install"):
        require("drawing", "plot", "taxel_nowhere.part")


def test_every_extra_that_a_command_names_exists() -> None:
    for entry in entry_points(group=cli.COMMANDS):
        entry.load()
    named = {extra for extra, _ in cli._NEEDS.values()}
    assert named == {"server", "train", "loop", "study", "bench", "ros2", "gazebo", "watch"}
    assert named < set(metadata("taxel").get_all("Provides-Extra") or ())
