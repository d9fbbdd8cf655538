"""What the matrix found: a table for people, one object for programs."""

import platform
import sys
import time
from dataclasses import asdict, dataclass, field
from typing import Any


@dataclass
class Outcome:
    """One check in one environment; `error` is empty where it passed."""

    check: str
    seconds: float
    error: str = ""


@dataclass
class Cell:
    """One environment.

    Attributes:
        versions: `newest` or `lowest` of what is declared, or `tested` (constraints.txt).
        installed: the version of each package that Taxel and its extra brought.
    """

    python: str
    extra: str
    versions: str
    installed: dict[str, str] = field(default_factory=dict)
    outcomes: list[Outcome] = field(default_factory=list)

    @property
    def label(self) -> str:
        """Names the environment in progress and tables."""
        return f"Python {self.python}, {f'taxel[{self.extra}]' if self.extra else 'taxel'}, {self.versions}"

    @property
    def passed(self) -> bool:
        """Whether every check did."""
        return bool(self.outcomes) and not any(outcome.error for outcome in self.outcomes)


def all_passed(cells: list[Cell]) -> bool:
    """Whether every environment did, and there was one."""
    return bool(cells) and all(cell.passed for cell in cells)


def say(text: str) -> None:
    """Progress, on stderr."""
    print(f"{time.strftime('%H:%M:%S')} {text}", file=sys.stderr, flush=True)


def table(cells: list[Cell], missing: list[str]) -> str:
    """A line for each environment, and what failed below."""
    lines = [f"{'Python':8} {'installed':16} {'versions':8} {'seconds':>7}  checks"]
    for cell in cells:
        seconds = sum(outcome.seconds for outcome in cell.outcomes)
        checks = ", ".join(f"{one.check}{' FAILED' if one.error else ''}" for one in cell.outcomes)
        name = f"taxel[{cell.extra}]" if cell.extra else "taxel"
        lines.append(f"{cell.python:8} {name:16} {cell.versions:8} {seconds:7.0f}  {checks}")
    for cell in cells:
        lines += [f"\n{cell.label}: {one.check}\n{one.error}" for one in cell.outcomes if one.error]
    if missing:
        lines.append(f"\nNot on this machine: Python {', '.join(missing)}.")
    failed = sum(not cell.passed for cell in cells)
    counted = f"\n{len(cells)} environments, {failed} failed."
    lines.append(f"\nAll {len(cells)} passed." if all_passed(cells) else counted)
    return "\n".join(lines)


def as_object(cells: list[Cell], missing: list[str]) -> dict[str, Any]:
    """What `--json` prints."""
    return {
        "system": f"{platform.system()} {platform.machine()}",
        "pythons_missing": missing,
        "passed": all_passed(cells),
        "cells": [{**asdict(cell), "passed": cell.passed} for cell in cells],
    }
