"""`taxel recording`: what a recording holds, and its conversion."""

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.progress import Progress
from rich.table import Table
from rich.text import Text

from taxel.atomic import check_file_place
from taxel.commands.cli import ERR, OUT, Json, print_json
from taxel.dependencies import require
from taxel.errors import SettingsError
from taxel.ros2.settings import SHADOW_FINGERS

if TYPE_CHECKING:
    from taxel_models.recordings import Recording
    from taxel_models.recordings.summary import Summary

Source = Annotated[
    Path,
    typer.Argument(
        metavar="PATH", help="A Ruppel CSV file, a folder of BioTac slide trials, or a bag of ROS."
    ),
]
Plot = Annotated[
    Path | None, typer.Option("--plot", metavar="PNG", help="Draw it over time; .pdf and .svg work too.")
]
Output = Annotated[
    Path | None,
    typer.Option(
        "--output",
        "-o",
        metavar="PATH",
        help="Write it: NAME.mcap as MCAP, without a suffix as a rosbag2 folder, else as Ruppel CSV.",
    ),
]
Finger = Annotated[
    str | None, typer.Option(help="Which finger of a bag is read, or written: ff, mf, rf, lf or th.")
]


Strict = Annotated[bool, typer.Option("--strict", help="Fail if something in it looks wrong.")]


def recording(
    path: Source,
    plot: Plot = None,
    output: Output = None,
    finger: Finger = None,
    strict: Strict = False,
    as_json: Json = False,
) -> None:
    """Summarise a recording: rows, segments, rates, ranges, what was dropped, and what looks wrong."""
    from taxel_models.recordings.findings import check_recording
    from taxel_models.recordings.summary import summarise

    if plot is not None:
        require("--plot", "plot", "matplotlib")
    if finger not in (None, *SHADOW_FINGERS):
        raise SettingsError(f"--finger {finger}: expected one of {', '.join(SHADOW_FINGERS)}")
    if output is not None and output.suffix:
        check_file_place(output, reads=path)
    read = _read(path, finger)
    if strict:
        check_recording(read, strict=True)
    if output is not None:
        _write(read, output, finger)
    if plot is not None:
        from taxel_models.recordings.recording_plot import draw

        draw(read, plot)
    summary = summarise(read)
    if as_json:
        print_json({**asdict(summary), "findings": [finding._asdict() for finding in summary.findings]})
    else:
        _print(summary)


def _write(read: "Recording", output: Path, finger: str | None) -> None:
    from taxel_models.recordings import write_ros_bag, write_ruppel

    if output.suffix in ("", ".mcap"):
        write_ros_bag(read, output, finger or SHADOW_FINGERS[0])
    else:
        write_ruppel(read, output)


def _read(path: Path, finger: str | None) -> "Recording":
    from taxel_models.recordings.reading import read_unchecked

    with Progress(console=ERR, transient=True, disable=not ERR.is_terminal) as bar:
        task = bar.add_task("reading", total=None)
        return read_unchecked(
            path, lambda done, total: bar.update(task, completed=done, total=total), finger=finger
        )


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
    for finding in summary.findings:
        facts.add_row("looks wrong", Text(f"{finding.name}: {finding.text}"))
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
