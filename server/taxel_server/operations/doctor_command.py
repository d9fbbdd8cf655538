"""`taxel doctor`: looks at the machine and says what is wrong there, and what to do."""

from dataclasses import asdict
from typing import Annotated, Final

import typer
from rich.text import Text

from taxel.commands.cli import OUT, Json, print_json
from taxel_server.operations.doctor import PORT, Finding, examine

_MARKS: Final = {"good": ("✓", "green"), "note": ("!", "yellow"), "bad": ("✗", "red")}


def doctor(
    port: Annotated[int, typer.Option(min=1, max=65_535, help="The port that a server is to have.")] = PORT,
    as_json: Json = False,
) -> None:
    """Look at what decides how well Taxel runs here: Python, processor, clocks, files, memory, ports.

    It changes no setting and takes about a second. Exit code 1: something keeps Taxel from running.
    """
    findings = []
    for finding in examine(port):
        findings.append(finding)
        if not as_json:
            _print(finding)
    if as_json:
        print_json({"findings": [asdict(finding) for finding in findings]})
    if any(finding.grade == "bad" for finding in findings):
        raise typer.Exit(1)


def _print(finding: Finding) -> None:
    mark, colour = _MARKS[finding.grade]
    line = Text.assemble((mark, colour), " ", (f"{finding.subject:<14}", "bold"), finding.found)
    OUT.print(line, soft_wrap=True)
    if finding.remedy:
        OUT.print(Text(f"  {'':<14}{finding.remedy}"), soft_wrap=True)
