"""What `make matrix` would run, without its hour: every extra, and tests that can be imported there."""

import ast
import importlib
import re
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
IMPORTED_AS = {"eclipse-zenoh": "zenoh", "prometheus-client": "prometheus_client", "xgboost-cpu": "xgboost"}


@pytest.fixture
def matrix(monkeypatch: pytest.MonkeyPatch) -> Iterator[ModuleType]:
    """Its table of extras; its files are scripts beside each other, not a package."""
    monkeypatch.syspath_prepend(str(ROOT / "tests" / "matrix"))
    before = set(sys.modules)
    yield importlib.import_module("extras")
    for name in set(sys.modules) - before:
        del sys.modules[name]


def test_every_extra_is_tried_by_itself(matrix: ModuleType) -> None:
    users = {*PROJECT["optional-dependencies"]} - {"all", "dev"}
    assert {*matrix.EXTRAS} - {"client"} == users


def test_all_has_every_extra() -> None:
    extras: dict[str, list[str]] = PROJECT["optional-dependencies"]
    found, left = set[str](), ["all"]
    while left:
        for requirement in extras[left.pop()]:
            if brought := re.fullmatch(r"taxel\[(.*)\]", requirement):
                names = brought.group(1).split(",")
                found |= {*names}
                left += names
    assert found == {*extras} - {"all", "dev"}


def test_its_tests_import_only_what_a_server_has(matrix: ModuleType) -> None:
    """There, one import of something else would fail before the first test."""
    serving = importlib.import_module("serving")
    there = {
        "taxel",
        *serving.TOOLS,
        *PROJECT["dependencies"],
        *PROJECT["optional-dependencies"]["server"],
    }
    names = {re.split(r"[\[><=; ]", one)[0] for one in there}
    allowed = {IMPORTED_AS.get(name, name.replace("-", "_")) for name in names} | {*sys.stdlib_module_names}
    # pytest needs packaging.
    allowed |= {path.name for path in ROOT.glob("*/taxel_*")} | {"taxel", "tests", "packaging"}
    ignored = [ROOT / "tests" / "clients" / name for name in serving.OTHER_EXTRAS]
    files = [ROOT / name for name in (*serving.TESTS, *serving.FIXTURES)]
    files += [file for folder in files if folder.is_dir() for file in folder.rglob("*.py")]
    read = 0
    for file in files:
        if file.is_dir() or any(file.is_relative_to(path) for path in ignored):
            continue
        read += 1
        for node in ast.parse(file.read_text()).body:
            modules: list[str] = []
            if isinstance(node, ast.Import):
                modules = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom) and not node.level:
                modules = [node.module or ""]
            needed = {module.partition(".")[0] for module in modules} - allowed
            assert not needed, f"{file}: imports {needed}"
    assert read > 20
