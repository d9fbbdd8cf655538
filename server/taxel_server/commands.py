"""`taxel serve`: a repository's models, answered over zenoh and the lane."""

import gc
import json
import logging
import os
import signal
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from threading import Event, Timer
from types import FrameType
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal

import typer

from taxel.commands.cli import ERR, OUT, Json, needs, nowhere
from taxel.dependencies import SERVING
from taxel.errors import ArtifactError, TaxelError
from taxel.local import shipped_repository
from taxel.predictor import ModelInfo
from taxel_server.operations.log_format import LogFormat, set_up_log
from taxel_server.operations.service_manager import ServiceManager
from taxel_server.options import Admin, ServerOptions

if TYPE_CHECKING:
    from taxel_server.loading.loader import Loader
    from taxel_server.service import Service

_LOG: Final = logging.getLogger(__name__)

STOPPING: Final = (signal.SIGINT, signal.SIGTERM)

_AFTER_DRAINING_S: Final = 0.3
"""The longest time that stopping takes after draining, even if something hangs."""

_LAST_ANSWERS_S: Final = 0.05
"""Time for the last answers to leave this process."""

LogLevel = Literal["debug", "info", "warning", "error"]


def _option(field: str, metavar: str | None = None) -> Any:
    """A server option on the command line. If it is not set, the other sources decide."""
    described = ServerOptions.model_fields[field]
    default = described.get_default()
    shown = ", ".join(default) if isinstance(default, tuple) else str(default)
    name = f"--{field.replace('_', '-')}"
    if described.annotation is bool:
        name += f"/--no-{field.replace('_', '-')}"
    return typer.Option(
        name,
        metavar=metavar,
        help=described.description,
        show_default=False if default is None else shown,
    )


@needs("server", *SERVING)
def serve(
    repository: Annotated[Path | None, _option("repository", "REPO")] = None,
    listen: Annotated[list[str] | None, _option("listen", "ENDPOINT")] = None,
    tls_certificate: Annotated[Path | None, _option("tls_certificate", "PEM")] = None,
    tls_key: Annotated[Path | None, _option("tls_key", "PEM")] = None,
    tls_client_ca: Annotated[Path | None, _option("tls_client_ca", "PEM")] = None,
    users: Annotated[Path | None, _option("users", "FILE")] = None,
    allow: Annotated[list[str] | None, _option("allow", "NAME=RIGHTS")] = None,
    prefix: Annotated[str | None, _option("prefix", "KEY")] = None,
    max_batch_rows: Annotated[int | None, _option("max_batch_rows", "N")] = None,
    max_request_rows: Annotated[int | None, _option("max_request_rows", "N")] = None,
    max_queue_rows: Annotated[int | None, _option("max_queue_rows", "N")] = None,
    max_queue_requests: Annotated[int | None, _option("max_queue_requests", "N")] = None,
    max_queue_mib: Annotated[int | None, _option("max_queue_mib", "N")] = None,
    max_queue_seconds: Annotated[float | None, _option("max_queue_seconds", "S")] = None,
    threads: Annotated[int | None, _option("threads", "N")] = None,
    providers: Annotated[list[str] | None, _option("providers", "NAME")] = None,
    shared_memory: Annotated[bool | None, _option("shared_memory")] = None,
    lane: Annotated[str | None, _option("lane", "WHERE")] = None,
    spin_us: Annotated[int | None, _option("spin_us", "N")] = None,
    halt: Annotated[bool | None, _option("halt")] = None,
    http: Annotated[str | None, _option("http", "HOST:PORT")] = None,
    websocket: Annotated[str | None, _option("websocket", "HOST:PORT")] = None,
    websocket_origins: Annotated[list[str] | None, _option("websocket_origins", "ORIGIN")] = None,
    watchable: Annotated[bool | None, _option("watchable")] = None,
    load_seconds: Annotated[int | None, _option("load_seconds", "S")] = None,
    load_memory_mib: Annotated[int | None, _option("load_memory_mib", "MIB")] = None,
    watch_seconds: Annotated[float | None, _option("watch_seconds", "S")] = None,
    admin: Annotated[Admin | None, _option("admin")] = None,
    drain_seconds: Annotated[float | None, _option("drain_seconds", "S")] = None,
    log_level: Annotated[LogLevel, typer.Option(help="What to log on stderr.")] = "warning",
    log_format: Annotated[LogFormat, typer.Option(help="How to log it: text or JSON.")] = "text",
    as_json: Json = False,
) -> None:
    """Serve the models of a repository, or those that come with Taxel, until told to stop.

    Every option may also be an environment variable (TAXEL_REPOSITORY, TAXEL_LISTEN …) or a key of
    taxel.toml in the working directory. SIGINT and SIGTERM finish the queued requests; a second
    signal exits at once. SIGHUP loads new versions beside those that are served.
    """
    given = {name: value for name, value in locals().items() if name in ServerOptions.model_fields}
    _exit_at_once_on(STOPPING, code=0)
    hangup = _hangup_event()
    terminal = os.isatty(0)

    from taxel_server.engine import Engine
    from taxel_server.loading.loader import Loader
    from taxel_server.loading.trials import Trials
    from taxel_server.memory import limit_arenas
    from taxel_server.processor import allow_open_files, keep_cores_awake
    from taxel_server.runtimes import RuntimeOptions
    from taxel_server.service import Service
    from taxel_server.settings import read_settings

    limit_arenas()
    allow_open_files()
    set_up_log(log_level, log_format)
    _log_errors_of_zenoh()
    settings = read_settings({name: value for name, value in given.items() if value is not None})
    repository = settings.repository or shipped_repository()
    awake = None if settings.halt else keep_cores_awake()
    engine = Engine(repository, RuntimeOptions(settings.threads, settings.providers))
    loader = Loader(engine, Trials(settings.load_seconds, settings.load_memory_mib), settings.watch_seconds)
    loader.start()
    loader.wait()
    if not engine.loaded():
        raise ArtifactError(_nothing_to_serve(repository, engine.models()))
    # Python would search what a server keeps for good for garbage, while requests wait some 0.1 s.
    gc.collect()
    gc.freeze()
    stop = _event_on(STOPPING)
    try:
        service = Service(engine, settings, loader).start()
    except TaxelError:
        loader.close()
        raise
    try:
        _announce(settings.listen, service, engine.models(), as_json)
    except OSError as error:
        _LOG.warning("stdout takes no announcement: %s; serving all the same", error)
        sys.stdout = nowhere()
    manager = ServiceManager()
    manager.tell("READY=1", f"STATUS=serving {len(engine.loaded())} versions")
    while _serve_until(stop, hangup, service, loader, manager) and not _has_gone(terminal):
        _LOG.info("reloading")
        manager.tell_reloading()
        loader.reload()
    manager.tell("STOPPING=1")
    if awake is not None:
        awake.close()
    _leave_within(settings.drain_seconds + _AFTER_DRAINING_S, service.abandon)
    if not service.close():
        ERR.print("a client has stopped reading: leaving without it", style="yellow")
        # The session would wait for that client on the way out of the interpreter, too.
        _exit_now(0)


def _serve_until(
    stop: Event, hangup: Event, service: "Service", loader: "Loader", manager: ServiceManager
) -> bool:
    """Give the watchdog its signs until a signal comes. Returns whether it was SIGHUP."""
    from taxel.zenoh_process import SIGNAL_CHECK_S

    loading = True
    while not stop.wait(SIGNAL_CHECK_S):
        if hangup.is_set():
            hangup.clear()
            return True
        if loading and loader.is_idle:
            loading = False
            _LOG.info("loaded", extra={"fields": dict(loader.counts)})
            manager.tell("READY=1", f"STATUS=serving {loader.served} versions")
        if manager.expects_sign and service.is_live:
            manager.give_sign()
    return False


def _hangup_event() -> Event:
    """An event that SIGHUP sets, where the system has this signal."""
    event = Event()
    if number := getattr(signal, "SIGHUP", None):
        signal.signal(number, lambda *_: event.set())
    return event


def _has_gone(terminal: bool) -> bool:
    """Whether SIGHUP came because the terminal, if the server was started in one, was closed."""
    return terminal and not os.isatty(0)


def _log_errors_of_zenoh() -> None:
    """Send zenoh's own errors to stderr, where the log goes.

    zenoh writes them to file descriptor 1. This command announces itself on stdout, so stdout gets
    another descriptor, and descriptor 1 becomes stderr's.
    """
    import zenoh

    announcements = os.dup(sys.stdout.fileno())
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    sys.stdout = os.fdopen(announcements, "w", encoding="utf-8")
    if not sys.stderr.isatty():
        os.environ.setdefault("NO_COLOR", "1")  # zenoh colours its log in a file, too
    zenoh.init_log_from_env_or("error")


def _announce(listen: tuple[str, ...], service: "Service", models: list[ModelInfo], as_json: bool) -> None:
    """Print on stdout that the server is ready; for programs, one JSON object in one line."""
    if as_json:
        ready = {
            "listen": list(listen),
            "lane": service.lane.address if service.lane else None,
            "http": service.http,
            "websocket": service.websocket,
            "models": [asdict(model) for model in models],
        }
        sys.stdout.write(json.dumps(ready) + "\n")
        sys.stdout.flush()
        return
    for model in models:
        reason = f": {model.reason}" if model.reason else ""
        OUT.print(f"{model.name}/{model.version} {model.state}{reason}", markup=False, soft_wrap=True)
    if service.http:
        OUT.print(f"metrics on http://{service.http}/metrics", soft_wrap=True)
    if service.websocket:
        OUT.print(f"web pages on {service.websocket}", soft_wrap=True)
    OUT.print(f"listening on {', '.join(listen)}", soft_wrap=True)
    sys.stdout.flush()


def _nothing_to_serve(repository: Path, models: list[ModelInfo]) -> str:
    reasons = "".join(f"\n  {model.reason}" for model in models)
    return f"{repository}: no model that can be served{reasons or '; the folder holds none'}"


def _exit_at_once_on(signals: tuple[signal.Signals, ...], code: int) -> None:
    def leave(number: int, frame: FrameType | None) -> None:
        del number, frame
        _exit_now(code)

    for each in signals:
        signal.signal(each, leave)


def _event_on(signals: tuple[signal.Signals, ...]) -> Event:
    """An event that the first of the signals sets; the second exits at once, with code 1."""
    event = Event()

    def stop(number: int, frame: FrameType | None) -> None:
        del number, frame
        _exit_at_once_on(signals, code=1)
        event.set()

    for each in signals:
        signal.signal(each, stop)
    return event


def _leave_within(seconds: float, abandon: Callable[[], None]) -> None:
    """After `seconds`, answer all open requests and exit, even during an evaluation or a close."""

    def leave() -> None:
        abandon()
        time.sleep(_LAST_ANSWERS_S)
        _exit_now(0)

    last = Timer(seconds, leave)
    last.daemon = True
    last.start()


def _exit_now(code: int) -> None:
    """Exit without cleaning up: nothing open needs it."""
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError):
            stream.flush()
    os._exit(code)
