"""`taxel watch`: look at fingertips while they are touched."""

import asyncio
import json
import signal
import sys
import webbrowser
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer

from taxel.commands.cli import ERR, OUT, needs
from taxel.commands.models import Connect, Repository
from taxel.dependencies import require
from taxel.errors import SettingsError

if TYPE_CHECKING:
    from taxel_watch.opening import Wanted
    from taxel_watch.outputs.output import Output
    from taxel_watch.scene import Source

_PORT: Final = 7450
_SPAWN: Final = "spawn"
_FOXGLOVE_HOST: Final = "127.0.0.1"


@needs("watch")
def watch(
    recordings: Annotated[
        list[Path] | None,
        typer.Argument(metavar="[RECORDING]...", help="Recordings to replay, one a fingertip."),
    ] = None,
    demo: Annotated[bool, typer.Option("--demo", help="Show the twin, a simulated hand.")] = False,
    model: Annotated[
        str | None, typer.Option(metavar="NAME[/VERSION]", help="Predict the recordings with this model.")
    ] = None,
    corrected: Annotated[
        str | None, typer.Option(metavar="NAME[/VERSION]", help="And with this corrected version of it.")
    ] = None,
    connect: Connect = None,
    repository: Repository = None,
    host: Annotated[str, typer.Option(help="Where to serve the page.")] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=0, max=65_535, help="Its port; 0 takes any free one.")] = _PORT,
    open_page: Annotated[bool, typer.Option("--open/--no-open", help="Open the page in a browser.")] = True,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print the address as one JSON object, and open no browser.")
    ] = False,
    terminal: Annotated[
        bool, typer.Option("--terminal", help="No page: draw in this terminal, as over ssh.")
    ] = False,
    mcap: Annotated[
        Path | None, typer.Option(metavar="FILE", help="No page: write an MCAP file.", dir_okay=False)
    ] = None,
    foxglove: Annotated[
        int | None,
        typer.Option(metavar="PORT", min=0, max=65_535, help="No page: a WebSocket for the Foxglove app."),
    ] = None,
    rerun: Annotated[
        str | None,
        typer.Option(
            metavar="FILE", help="No page: write an .rrd file of Rerun; `spawn` opens its viewer."
        ),
    ] = None,
) -> None:
    """Show fingertips in a browser: those of a running server, of recordings, or of the twin.

    With --connect alone, the page shows what a server answers; the server must run with --watchable. With
    recordings or --demo, --connect names the server that predicts them. Ctrl-C ends it.
    """
    from taxel_watch.opening import Wanted, opened

    wanted = Wanted(tuple(recordings or ()), demo, model, corrected, connect, repository)
    if [terminal, mcap is not None, foxglove is not None, rerun is not None].count(True) > 1:
        raise SettingsError("expected at most one of --terminal, --mcap, --foxglove and --rerun")
    if mcap is not None or foxglove is not None or rerun is not None:
        _write(wanted, mcap, foxglove, rerun)
        return
    if not terminal:
        require("the page", "watch", "websockets")
    with opened(wanted) as source:
        if terminal:
            from taxel_watch.terminal import draw

            draw(source.player(), OUT)
        else:
            asyncio.run(_serve(source, host, port, opens=open_page and not as_json, as_json=as_json))


def _write(wanted: "Wanted", mcap: Path | None, foxglove: int | None, rerun: str | None) -> None:
    """Give a recording to another tool at once, as a file, or any source as it comes."""
    if rerun is not None:
        require("--rerun", "rerun", "rerun")
    else:
        require("--mcap" if mcap else "--foxglove", "foxglove", "foxglove")
    from taxel_watch.opening import opened
    from taxel_watch.outputs.output import of_whole, write_all, write_as_it_comes
    from taxel_watch.replay import Replay

    at_once = foxglove is None and rerun != _SPAWN
    with opened(wanted, whole=at_once) as source:
        output = _output(mcap, foxglove, rerun)
        try:
            if at_once and isinstance(source, Replay):
                write_all(source.scene(), of_whole(source), output)
            else:
                ERR.print("Ctrl-C ends it")
                write_as_it_comes(source.player(), output)
        finally:
            output.close()
    if (file := mcap or (rerun if at_once else None)) is not None:
        OUT.print(f"Wrote {file}.", soft_wrap=True)


def _output(mcap: Path | None, foxglove: int | None, rerun: str | None) -> "Output":
    if rerun is not None:
        from taxel_watch.outputs.rerun_output import rerun_file, rerun_viewer

        return rerun_viewer() if rerun == _SPAWN else rerun_file(Path(rerun))
    from taxel_watch.outputs.foxglove_output import foxglove_server, mcap_file

    if mcap is not None:
        return mcap_file(mcap)
    output, address = foxglove_server(_FOXGLOVE_HOST, foxglove or 0)
    OUT.print(f"{address}   open it in Foxglove as a WebSocket connection", soft_wrap=True)
    sys.stdout.flush()
    return output


async def _serve(source: "Source", host: str, port: int, *, opens: bool, as_json: bool) -> None:
    """Serve the page until SIGINT or SIGTERM."""
    from taxel_watch.page_server import page_server

    stop = asyncio.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        asyncio.get_running_loop().add_signal_handler(number, stop.set)
    async with page_server(source, host, port) as address:
        if as_json:
            sys.stdout.write(json.dumps({"address": address}) + "\n")
            sys.stdout.flush()
        else:
            OUT.print(f"{address}   Ctrl-C ends it", soft_wrap=True)
        if opens:
            webbrowser.open(address)
        await stop.wait()
