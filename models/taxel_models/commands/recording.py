"""`taxel recording`: what a recording holds, and its conversion to Ruppel CSV."""

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.progress import Progress
from rich.table import Table

from taxel.commands.cli import ERR, OUT, Json, print_json
from taxel.dependencies import require

if TYPE_CHECKING:
    from taxel_models.recordings import Recording
    from taxel_models.recordings.summary import Summary

Source = Annotated[
    Path, typer.Argument(metavar="PATH", help="A Ruppel CSV file, or a folder of BioTac slide trials.")
]
Plot = Annotated[
    Path | None, typer.Option("--plot", metavar="PNG", help="Draw it over time; .pdf and .svg work too.")
]
Output = Annotated[
    Path | None, typer.Option("--output", "-o", metavar="CSV", help="Write it as Ruppel CSV.")
]


def recording(path: Source, plot: Plot = None, output: Output = None, as_json: Json = False) -> None:
    """Summarise a recording: rows, segments, rates, ranges, and what was dropped and why."""
    from taxel_models.recordings import write_ruppel
    from taxel_models.recordings.summary import summarise

    if plot is not None:
        require("--plot", "plot", "matplotlib")
    read = _read(path)
    if output is not None:
        write_ruppel(read, output)
    if plot is not None:
        from taxel_models.recordings.recording_plot import draw

        draw(read, plot)
    summary = summarise(read)
    if as_json:
        print_json(asdict(summary))
    else:
        _print(summary)


def _read(path: Path) -> "Recording":
    from taxel_models.recordings import read_recording

    with Progress(console=ERR, transient=True, disable=not ERR.is_terminal) as bar:
        task = bar.add_task("reading", total=None)
        return read_recording(path, lambda done, total: bar.update(task, completed=done, total=total))


def _print(summary: "Summary") -> None:
    from taxel_models.recordings.summary import UNITS

    facts = Table(show_header=False, box=None)
    facts.add_column()
    facts.add_column(overflow="fold")
    facts.add_row("name", summary.name)
    facts.add_row("format", summary.format)
    facts.add_row("sha256", summary.sha256)
    facts.add_row("rows", f"{summary.rows:,}")
    facts.add_row("segments", f"{summary.segments:,}")
    facts.add_row("seconds", f"{summary.seconds:,.2f}")
    facts.add_row("median rate", f"{summary.rate_hz:.2f} Hz")
    for reason, rows in summary.dropped.items():
        facts.add_row("dropped", f"{rows:,} rows: {reason}")
    if not summary.dropped:
        facts.add_row("dropped", "nothing")
    OUT.print(facts)

    table = Table("column", "unit")
    table.columns[0].no_wrap = True
    for heading in ("min", "mean", "max", "sd", "repeats"):
        table.add_column(heading, justify="right")
    for group, columns in summary.columns.items():
        for name, statistics in columns.items():
            values = (statistics.minimum, statistics.mean, statistics.maximum, statistics.sd)
            table.add_row(
                name, UNITS[group], *(f"{value:.4g}" for value in values), f"{statistics.repeats:.1%}"
            )
        table.add_section()
    OUT.print(table)
