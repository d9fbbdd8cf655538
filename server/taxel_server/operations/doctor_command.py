"""`taxel doctor`: looks at the machine and says what is wrong there, and what to do."""

from dataclasses import asdict
from typing import Annotated, Final

import typer
from rich.text import Text

from taxel.commands.cli import OUT, Json, print_json
from taxel_server.operations.doctor import PORT, Check, examine

_MARKS: Final = {"good": ("✓", "green"), "note": ("!", "yellow"), "bad": ("✗", "red")}


def doctor(
    port: Annotated[int, typer.Option(min=1, max=65_535, help="The port that a server is to have.")] = PORT,
    as_json: Json = False,
) -> None:
    """Look at what decides how well Taxel runs here: Python, processor, clocks, files, memory, ports.

    It changes no setting and takes about a second. Exit code 1: something keeps Taxel from running.
    """
    checks = []
    for check in examine(port):
        checks.append(check)
        if not as_json:
            _print(check)
    if as_json:
        print_json({"findings": [asdict(check) for check in checks]})
    if any(check.grade == "bad" for check in checks):
        raise typer.Exit(1)


def _print(check: Check) -> None:
    mark, colour = _MARKS[check.grade]
    line = Text.assemble((mark, colour), " ", (f"{check.subject:<14}", "bold"), check.found)
    OUT.print(line, soft_wrap=True)
    if check.remedy:
        OUT.print(Text(f"  {'':<14}{check.remedy}"), soft_wrap=True)
