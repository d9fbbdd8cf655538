"""Commands in forks of one process that has imported what they need.

Small as the tests make a page's commands, importing PyTorch takes each of them longer than its work. So a
small program of the same name stands on the PATH. It hands its arguments, folder, environment and files to
this process, whose fork does the work, and ends as that one ends.
"""

import atexit
import gc
import json
import os
import runpy
import signal
import socket
import subprocess
import sys
import threading
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any, Final, NoReturn

PROGRAMS: Final = ("taxel", "bench", "python", "dask")

IMPORTED: Final = (
    *("distributed", "matplotlib.pyplot", "mujoco", "onnxscript", "scipy.optimize"),
    *("scipy.stats", "smac", "statsmodels.stats.multitest", "torch", "xgboost", "zenoh"),
    *("taxel.commands.cli", "taxel.mujoco", "taxel.remote", "taxel.torch", "taxel_bench.commands"),
    *(
        "taxel_exporters.export",
        "taxel_exporters.loop",
        "taxel_models.calibration",
        "taxel_models.loop.pipeline",
    ),
    *("taxel_models.recovery.benchmark", "taxel_models.search.run", "taxel_models.study.run"),
    *("taxel_models.training.train", "taxel_server.local", "taxel_server.service"),
)
"""What takes long to import. What is not installed is left out."""

STARTER: Final = """#!{python} -IS
import json, os, signal, socket, sys
with socket.socket(socket.AF_UNIX) as warm:
    warm.connect({place!r})
    asked = {{"words": [os.path.basename(sys.argv[0]), *sys.argv[1:]], "folder": os.getcwd()}}
    text = json.dumps(asked | {{"environment": dict(os.environ)}}).encode()
    socket.send_fds(warm, [len(text).to_bytes(4, "big")], [0, 1, 2])
    warm.sendall(text)
    pid = int.from_bytes(warm.recv(4), "big")
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda number, _: os.kill(pid, number))
    code = warm.recv(1)
sys.exit(code[0] if code else 1)
"""


@contextmanager
def warm_programs(folder: Path) -> Iterator[Path]:
    """A folder with `PROGRAMS`, for the PATH.

    Args:
        folder: where it is made.
    """
    place = str(folder / "warm")
    (folder / "bin").mkdir()
    for name in PROGRAMS:
        program = folder / "bin" / name
        program.write_text(STARTER.format(python=sys.executable, place=place))
        program.chmod(0o755)
    process = subprocess.Popen(
        [sys.executable, __file__, place],
        env={**os.environ, "COLUMNS": "120", "OPENBLAS_NUM_THREADS": "1"},
        stdout=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    assert process.stdout is not None
    try:
        assert process.stdout.readline() == "ready\n"
        yield folder / "bin"
    finally:
        os.killpg(process.pid, signal.SIGKILL)
        process.communicate()


def _asked(place: str) -> dict[str, Any]:
    """What a fork has to do; the first process never returns."""
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind(place)
        listening.listen(16)
        signal.signal(signal.SIGCHLD, signal.SIG_IGN)
        print("ready", flush=True)
        while True:
            connection, _ = listening.accept()
            with connection:
                if not os.fork():
                    listening.close()
                    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
                    return _begun(connection)


def _begun(connection: socket.socket) -> dict[str, Any]:
    """In a fork of this one, which tells the starter how it ends."""
    head, files, _, _ = socket.recv_fds(connection, 4, 3)
    text = b""
    while len(text) < int.from_bytes(head, "big"):
        text += connection.recv(1 << 16)
    if not (pid := os.fork()):
        for number, file in enumerate(files):
            os.dup2(file, number)
            os.close(file)
        asked: dict[str, Any] = json.loads(text)
        return asked
    for file in (0, 1, 2, *files):
        os.close(file)
    connection.sendall(pid.to_bytes(4, "big"))
    _, status = os.waitpid(pid, 0)
    connection.sendall(bytes([os.waitstatus_to_exitcode(status) & 0xFF]))
    os._exit(0)


def _ended(words: list[str], folder: str, environment: dict[str, str]) -> int:
    """The exit code of a command."""
    try:
        _run(words, folder, environment)
    except SystemExit as end:
        if end.code is None or isinstance(end.code, int):
            return end.code or 0
        print(end.code, file=sys.stderr)
        return 1
    except BaseException:
        traceback.print_exc()
        return 1
    return 0


def _leave(code: int) -> NoReturn:
    """End without taking apart what was imported: that takes a second."""
    threading._shutdown()  # type: ignore[attr-defined]
    atexit._run_exitfuncs()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)


def _run(words: list[str], folder: str, environment: dict[str, str]) -> None:
    os.chdir(folder)
    os.environ.clear()
    os.environ.update(environment)
    name, *arguments = sys.argv = words
    if name != "python":
        (entry,) = entry_points(group="console_scripts", name=name)
        sys.exit(entry.load()())
    sys.path[0] = ""
    if arguments[0] == "-c":
        sys.argv = ["-c", *arguments[2:]]
        exec(compile(arguments[1], "<string>", "exec"), {"__name__": "__main__"})
    elif arguments[0] == "-m":
        sys.argv = arguments[1:]
        runpy.run_module(arguments[1], run_name="__main__", alter_sys=True)
    else:
        sys.argv = arguments
        runpy.run_path(arguments[0], run_name="__main__")


if __name__ == "__main__":
    # A fork has one thread only: a lock that another held would never be let go. pyarrow, onnxruntime and
    # OpenBLAS start threads when they are imported.
    sys.modules["pyarrow"] = None  # type: ignore[assignment]
    for each in IMPORTED:
        try:
            import_module(each)
        except ImportError:
            continue
    del sys.modules["pyarrow"]
    assert len(list(Path("/proc/self/task").glob("*"))) <= 1
    gc.collect()
    gc.freeze()
    _leave(_ended(**_asked(sys.argv[1])))
