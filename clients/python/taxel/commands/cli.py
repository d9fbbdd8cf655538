"""The `taxel` command line: how commands are found, how they print, how they fail.

Results go to stdout, progress and errors to stderr; `--json` prints one object. Exit code 0
is success, 2 is bad use, and 1 is any other failure. rich honours `NO_COLOR`, and shows
colour and progress only on a terminal.
"""

import json
import os
import sys
import warnings
from collections.abc import Callable
from functools import wraps
from importlib.metadata import EntryPoint, entry_points
from io import TextIOWrapper
from typing import Annotated, Any, Final, TextIO, TypeVar

import typer
from rich.console import Console

from taxel import __version__
from taxel.dependencies import require
from taxel.errors import InputWarning, MissingDependency, SettingsError, TaxelError

COMMANDS: Final = "taxel.commands"

OUT: Final = Console(highlight=False)
"""Results."""

ERR: Final = Console(stderr=True, highlight=False)
"""Progress and errors."""

Json = Annotated[bool, typer.Option("--json", help="Print one JSON object instead of tables.")]


def print_json(value: Any) -> None:
    """Print one JSON object on stdout, for programs."""
    sys.stdout.write(json.dumps(value, indent=1, allow_nan=False) + "\n")


def new_app(help_text: str) -> typer.Typer:
    """A command group in the style of all commands."""
    return typer.Typer(
        help=help_text,
        no_args_is_help=True,
        add_completion=False,
        pretty_exceptions_enable=False,
        rich_markup_mode="markdown",
    )


_Command = TypeVar("_Command", bound=Callable[..., None])


def needs(extra: str, *packages: str) -> Callable[[_Command], _Command]:
    """Name the extra that a command needs. Its packages are checked before the command starts.

    Args:
        extra: the extra of Taxel that installs everything the command may import.
        packages: import names of the packages that it cannot start without.
    """

    def mark(command: _Command) -> _Command:
        _NEEDS[command] = (extra, packages)
        return command

    return mark


_NEEDS: Final[dict[Callable[..., None], tuple[str, tuple[str, ...]]]] = {}
"""The extra and the packages of each command."""


def failing_clearly(command: Callable[..., None]) -> Callable[..., None]:
    """Turn the errors that we raise on purpose into one line on stderr and an exit code."""
    extra, packages = _NEEDS.get(command, ("all", ()))

    @wraps(command)
    def run(*args: Any, **kwargs: Any) -> None:
        try:
            require("this command", extra, *packages)
            with warnings.catch_warnings():
                warnings.showwarning = _say_warning
                command(*args, **kwargs)
        except TaxelError as error:
            _say_error(error)
            raise typer.Exit(2 if isinstance(error, SettingsError) else 1) from None
        except KeyboardInterrupt:
            ERR.print("interrupted", style="yellow")
            raise typer.Exit(130) from None
        except OSError as error:
            _say_error(TaxelError(f"{error.filename}: {error.strerror}" if error.filename else str(error)))
            raise typer.Exit(1) from None
        except ModuleNotFoundError as error:
            if error.name is None or error.name.startswith("taxel"):
                raise
            _say_error(MissingDependency("this command", error.name.partition(".")[0], extra))
            raise typer.Exit(1) from None

    return run


def _say_error(error: TaxelError) -> None:
    ERR.print("[bold red]error:[/]", end=" ")
    ERR.print(str(error), markup=False, soft_wrap=True)


def _say_warning(message: Warning | str, category: type[Warning], *place: Any, **more: Any) -> None:
    """Warnings of inputs are for the user; others keep the form for programmers."""
    if not issubclass(category, InputWarning):
        _show_warning(message, category, *place, **more)
        return
    ERR.print("[bold yellow]warning:[/]", end=" ")
    ERR.print(str(message), markup=False, soft_wrap=True)


_show_warning: Final = warnings.showwarning


def _version(wanted: bool) -> None:
    if wanted:
        OUT.print(f"taxel {__version__}")
        raise typer.Exit


def build() -> typer.Typer:
    """The `taxel` command with every installed subcommand."""
    app = new_app("Taxel plays a BioTac tactile fingertip for robot simulators.")

    @app.callback()
    def root(
        version: Annotated[bool, typer.Option("--version", callback=_version, is_eager=True)] = False,
    ) -> None:
        """Taxel plays a BioTac tactile fingertip for robot simulators."""

    for entry in sorted(entry_points(group=COMMANDS), key=lambda entry: entry.name):
        command = _load(entry)
        if isinstance(command, typer.Typer):
            app.add_typer(command, name=entry.name)
        else:
            app.command(entry.name)(failing_clearly(command))
    return app


def _load(entry: EntryPoint) -> Callable[..., None] | typer.Typer:
    """A command or a group. If it cannot be loaded, it says so when it is called, and the others work."""
    try:
        command: Callable[..., None] | typer.Typer = entry.load()
    except Exception as error:  # another package's fault must not stop this command line
        reason = f"{type(error).__name__}: {error}"

        def command() -> None:
            raise TaxelError(f"the command {entry.name} ({entry.value}) cannot be loaded: {reason}")

        command.__doc__ = f"Not available: {reason}."
    return command


def main() -> None:
    """Entry point of the `taxel` command."""
    _open_closed_streams()
    _replace_unprintable()
    try:
        build()()
    except KeyboardInterrupt:
        # While commands are imported; each takes care of it while it runs.
        raise SystemExit(130) from None


def _open_closed_streams() -> None:
    """Give stdout and stderr a place where there is none, as after `>&-`: Python has None for them then."""
    if sys.stdout is None:
        sys.stdout = nowhere()
    if sys.stderr is None:
        sys.stderr = nowhere()


def _replace_unprintable() -> None:
    """Print `?` for what the terminal's encoding has no character for: our help has some beyond ASCII."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="replace")


def nowhere() -> TextIO:
    """A stream that keeps nothing."""
    return os.fdopen(os.open(os.devnull, os.O_WRONLY), "w", encoding="utf-8")
