"""Try the wheel on every Python, with the newest and the lowest packages, and each extra by itself.

    python3 tests/matrix [--python 3.12] [--versions lowest] [--json]
                         [--extra loop] [--extra-versions lowest] [--hold torch==2.13.0]

Exit status: 0 where every environment passed, 1 where one failed, none was tried or a Python that was
asked for is missing, 2 for bad use.
"""

import argparse
import json
import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

from environments import Environment, Failed, build_wheel, environment
from extras import EXTRAS
from pythons import SUPPORTED, Python, find
from report import Cell, Outcome, all_passed, as_object, say, table
from requirements import lowest
from serving import CHECKS, Check

ROOT = Path(__file__).resolve().parents[2]
CONSTRAINTS = ROOT / "constraints.txt"


def main() -> int:
    options = _options()
    pythons = find(tuple(options.python or SUPPORTED))
    missing = [minor for minor in options.python or SUPPORTED if minor not in pythons]
    say(f"found {', '.join(f'{one.version} ({one.path})' for one in pythons.values()) or 'no Python'}")
    if missing:
        say(f"missing: Python {', '.join(missing)}")
    if not pythons:
        return 1
    first = next(iter(pythons.values()))
    held = tuple(options.hold)
    with TemporaryDirectory(prefix="taxel-wheel-") as folder:
        say("building the wheel")
        wheel = build_wheel(first, ROOT, Path(folder).resolve())
        serving = [
            partial(_serving, python, wheel, versions, held)
            for python in pythons.values()
            for versions in options.versions
        ]
        alone = [
            partial(_extra, first, wheel, extra, versions, held)
            for versions in options.extra_versions
            for extra in options.extra
        ]
        with ThreadPoolExecutor(options.jobs) as pool:
            cells = list(pool.map(lambda step: step(), serving + alone))
    if options.json:
        print(json.dumps(as_object(cells, missing), indent=1))
    else:
        print(table(cells, missing))
    return 0 if all_passed(cells) and not (options.python and missing) else 1


def _serving(python: Python, wheel: Path, versions: str, held: tuple[str, ...]) -> Cell:
    """`taxel[server]` with the newest or the lowest packages."""

    def install(found: Environment) -> None:
        if versions == "newest":
            found.install(f"{wheel}[server]")
            return
        found.install(f"{wheel}[server]", constraints=lowest(found, ROOT, "server", held))

    return _tried(Cell(python.version, "server", versions), python, wheel, install, CHECKS)


def _extra(python: Python, wheel: Path, extra: str, versions: str, held: tuple[str, ...]) -> Cell:
    """An extra by itself, with the versions that the project is tested with, or with the lowest."""
    name = "" if extra == "client" else extra

    def install(found: Environment) -> None:
        limits = CONSTRAINTS if versions == "tested" else lowest(found, ROOT, name, held)
        found.install(f"{wheel}[{name}]" if name else wheel, constraints=limits)

    return _tried(Cell(python.version, name, versions), python, wheel, install, EXTRAS[extra])


def _tried(
    cell: Cell,
    python: Python,
    wheel: Path,
    install: Check,
    checks: tuple[Check, ...],
) -> Cell:
    """Fill in a cell: install, then every check. A failed installation leaves out the checks."""

    def steps() -> None:
        with environment(python, wheel) as found:
            if _passes(cell, "install", lambda: install(found)):
                cell.installed = found.installed()
                for check in checks:
                    _passes(cell, check.__name__, partial(check, found))

    if error := _error_of(cell, "environment", steps):
        cell.outcomes.append(Outcome("environment", 0.0, error))
    return cell


def _passes(cell: Cell, name: str, step: Callable[[], None]) -> bool:
    started = time.monotonic()
    say(f"{cell.label}: {name}")
    error = _error_of(cell, name, step)
    cell.outcomes.append(Outcome(name, round(time.monotonic() - started, 1), error))
    return not error


def _error_of(cell: Cell, name: str, step: Callable[[], None]) -> str:
    """What went wrong; empty if nothing did. Whatever it is, the other environments are tried."""
    try:
        step()
    except Exception as failure:
        error = str(failure) if isinstance(failure, Failed) else repr(failure)
        say(f"{cell.label}: {name} FAILED: {error[-300:]}")
        return error
    return ""


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="make matrix", description=__doc__.splitlines()[0])
    parser.add_argument(
        "--python", action="append", choices=SUPPORTED, help="Only this Python; may be given several times."
    )
    parser.add_argument(
        "--versions", action="append", choices=("newest", "lowest", "none"), help="Only these versions."
    )
    parser.add_argument(
        "--extra",
        action="append",
        choices=(*EXTRAS, "none"),
        help="Only this extra by itself.",
    )
    parser.add_argument(
        "--extra-versions",
        action="append",
        choices=("tested", "lowest"),
        help="Versions for an extra by itself: of constraints.txt (tested, the default), or lowest.",
    )
    parser.add_argument(
        "--hold",
        action="append",
        default=[],
        metavar="PACKAGE==VERSION",
        help="Take this version where the lowest ones are tried; may be given several times.",
    )
    parser.add_argument("--jobs", type=int, default=1, help="Environments at a time, of about 1 GB each.")
    parser.add_argument("--json", action="store_true", help="Print one JSON object instead of a table.")
    options = parser.parse_args()
    options.versions = [one for one in options.versions or ("newest", "lowest") if one != "none"]
    options.extra = [one for one in options.extra or EXTRAS if one != "none"]
    options.extra_versions = options.extra_versions or ["tested"]
    return options


if __name__ == "__main__":
    sys.exit(main())
