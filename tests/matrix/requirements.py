"""The project's direct requirements, and the lowest versions of them that a Python has wheels for."""

import re
import tomllib
from pathlib import Path

from environments import Environment, Failed

_REQUIREMENT = re.compile(r"(?P<name>[\w.-]+)(\[(?P<extras>[\w,-]+)\])?(>=(?P<lower>[\d.]+))?(;.*)?")
_RELEASE = re.compile(r"\d+(\.\d+)*(\.post\d+)?")
_PROJECT = "taxel"

Version = tuple[int, ...]


def extras(root: Path) -> dict[str, list[str]]:
    """The requirements of each extra, as pyproject.toml has them."""
    found: dict[str, list[str]] = _project(root)["optional-dependencies"]
    return found


def lower_bounds(root: Path, extra: str) -> dict[str, str]:
    """The lower bound of each direct requirement of the project with an extra, by package."""
    project = _project(root)
    bounds: dict[str, str] = {}
    waiting = [*project["dependencies"], f"{_PROJECT}[{extra}]"]
    while waiting:
        requirement = waiting.pop().replace(" ", "")
        found = _REQUIREMENT.fullmatch(requirement)
        if found is None:
            raise ValueError(f"pyproject.toml: {requirement}: expected NAME>=VERSION")
        if found["name"] == _PROJECT:
            for each in found["extras"].split(","):
                waiting += project["optional-dependencies"][each]
        elif found["lower"] is None:
            raise ValueError(f"pyproject.toml: {requirement}: expected a lower bound, as NAME>=VERSION")
        else:
            bounds[found["name"]] = found["lower"]
    return dict(sorted(bounds.items()))


def lowest(environment: Environment, bounds: dict[str, str]) -> dict[str, str]:
    """Each package's lowest version that is not below its bound and has a wheel for this Python."""
    return {name: _lowest(environment, name, bound) for name, bound in bounds.items()}


def _lowest(environment: Environment, name: str, bound: str) -> str:
    allowed = [
        version for version in _with_wheels(environment, name) if as_numbers(version) >= as_numbers(bound)
    ]
    if not allowed:
        raise Failed(f"no wheel of {name}>={bound} for this Python")
    return min(allowed, key=as_numbers)


def _with_wheels(environment: Environment, name: str) -> list[str]:
    """The releases of a package that have a wheel for this Python.

    `pip index versions` lists source archives, too. What pip says when no version fits lists wheels only.
    """
    done = environment.python(
        *("-m", "pip", "download", "--no-deps", "--only-binary", ":all:", f"{name}==0,<0"), check=False
    )
    found = re.search(r"from versions: ([^)]*)\)", done.stderr)
    if found is None:
        raise Failed(f"pip lists no versions of {name}: {done.stderr.strip()[-300:]}")
    return [version for version in found[1].split(", ") if _RELEASE.fullmatch(version)]


def as_numbers(version: str) -> Version:
    """A release as numbers to compare by, without the zeros at its end: 1.10.0 is 1.10."""
    numbers = [int(part) for part in re.findall(r"\d+", version)]
    while numbers and numbers[-1] == 0:
        numbers.pop()
    return tuple(numbers)


def _project(root: Path) -> dict:
    return tomllib.loads((root / "pyproject.toml").read_text())["project"]
