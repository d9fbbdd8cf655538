"""The project's direct requirements, and the lowest versions of them that a Python has wheels for."""

import tomllib
from pathlib import Path

from environments import PURE, Environment, environment


def extras(root: Path) -> dict[str, list[str]]:
    """The requirements of each extra, as pyproject.toml has them."""
    project = tomllib.loads((root / "pyproject.toml").read_text())["project"]
    by_extra: dict[str, list[str]] = project["optional-dependencies"]
    return by_extra


def lowest(found: Environment, root: Path, extra: str, held: tuple[str, ...] = ()) -> Path:
    """Constraints, as a file: each direct requirement of the project with an extra at its lower bound.

    Without an extra, if its name is empty. Each requirement of `held`, such as `torch==2.13.0`, stands in
    place of its package's lower bound.

    Where the index has no wheel of that version or of what it needs for its Python, the next
    one that has. uv resolves them, in an environment of its own.

    Raises:
        Failed: there are none.
    """
    constraints = found.work / "lowest.txt"
    limits = found.work / "held.txt"
    limits.write_text("".join(f"{one}\n" for one in held))
    chosen = ("--extra", extra) if extra else ()
    sources = [option for name in PURE for option in ("--no-binary", name)]
    with environment(found.interpreter) as resolver:
        resolver.install("uv")
        resolver.run(
            *("uv", "pip", "compile", root / "pyproject.toml", *chosen, "--quiet"),
            *("--resolution", "lowest-direct", "--only-binary", ":all:", *sources),
            *("--constraints", limits),
            *("--python", found.folder / "bin" / "python", "--output-file", constraints),
        )
    return constraints
