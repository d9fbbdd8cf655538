"""The process in which artifacts are tried out, or loaded for a server; `trials.py` starts it.

It forks a process for each artifact. The kernel kills this process when its time is over, whatever it
computes. What it may allocate is limited, too. So a model that never answers harms nobody.

While a server answers requests, such a process also does the work of loading: it parses, compiles, times
and warms up. The server reads the result, which takes it milliseconds.
"""

import json
import math
import os
import pickle
import resource
import signal
import sys
import time
import warnings
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

import numpy as np
from numba.core import event as numba_events
from typing_extensions import override

from taxel import artifacts
from taxel.errors import ArtifactError, TaxelError
from taxel_server.engine import load_model
from taxel_server.runtimes.graph_checks import check_graph
from taxel_server.runtimes.networks.graph import Unsupported, read_graph
from taxel_server.runtimes.networks.lowering import lower
from taxel_server.runtimes.options import RuntimeOptions

ROWS: Final = (1, 8, 64, 512)
"""Windows of the evaluations that are tried."""

_TOO_LONG: Final = (signal.SIGXCPU, signal.SIGALRM)
"""What the kernel kills with when the processor's time is over, and when that of the clock is."""

_WAITING_SHARE: Final = 10
"""How much longer a trial may take by the clock."""

_MOST_COMPILING_S: Final = 600
"""Of the processor, in all. Compiling our own functions is no fault of the artifact."""

_NICE: Final = 5
"""Steps by which a server's threads go before this process, where they want the same cores."""

_LONGEST_REASON: Final = 1500
"""Characters; a line of the pipe must fit into one write."""


def main() -> None:
    """Try the artifacts that stdin names, and print two lines of JSON for each."""
    task = json.load(sys.stdin)
    if task["result"] is not None:
        _give_way()
    waiting: list[str] = task["folders"]
    running: dict[int, str] = {}
    while waiting or running:
        while waiting and len(running) < task["at_once"]:
            folder = waiting.pop(0)
            _tell(folder=folder, started=True)
            running[_fork(Path(folder), task)] = folder
        process, status = os.wait()
        folder = running.pop(process)
        if os.WIFSIGNALED(status):
            _tell(folder=folder, reason=_death(os.WTERMSIG(status), task))
        elif os.WEXITSTATUS(status):
            _tell(folder=folder, reason=f"its trial ended with code {os.WEXITSTATUS(status)}")


def _give_way() -> None:
    os.nice(_NICE)
    with suppress(OSError):
        # Where the kernel shares the processor among sessions first, niceness counts only within one.
        Path("/proc/self/autogroup").write_text(str(_NICE), encoding="ascii")


def _tell(**fields: Any) -> None:
    try:
        os.write(1, (json.dumps(fields) + "\n").encode())
    except BrokenPipeError:
        # The server has been stopped.
        os._exit(1)


def _death(number: int, task: dict[str, Any]) -> str:
    if number in _TOO_LONG:
        return f"its trial took longer than {task['seconds']} s: expected a model that answers at once"
    return (
        f"its trial died with {signal.Signals(number).name}: it may need more than {task['memory_mib']} MiB"
    )


def _fork(folder: Path, task: dict[str, Any]) -> int:
    with warnings.catch_warnings():
        # Python warns of threads that libraries start when they are imported: ONNX Runtime's, jemalloc's.
        # This process never loads a model, so they idle; a child that hangs is killed by its time limit.
        warnings.filterwarnings("ignore", "This process .* is multi-threaded", DeprecationWarning)
        process = os.fork()
    if process:
        return process
    code = 1
    try:
        # Nothing handles these signals, so that they kill, even in the middle of a library's computation.
        for number in _TOO_LONG:
            signal.signal(number, signal.SIG_DFL)
        numba_events.register("numba:compiler_lock", _TimeLimit(task["seconds"]))
        _limit_memory(task["memory_mib"])
        # ONNX Runtime logs what fails, which the reason says, too.
        os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
        _tell(folder=str(folder), reason=_reason_against(folder, task)[:_LONGEST_REASON])
        code = 0
    finally:
        os._exit(code)


class _TimeLimit(numba_events.Listener):  # type: ignore[misc]  # numba has no types
    """The limit of this process's time. While numba compiles, it stands still.

    A busy machine makes a trial slow, not wrong: the processor's time counts, and ten times as much by the
    clock.
    """

    def __init__(self, seconds: int) -> None:
        self._seconds = seconds
        self._compiling_s = 0.0
        self._depth = 0
        self._began = 0.0
        self._limit()

    @override
    def on_start(self, event: Any) -> None:
        self._depth += 1
        if self._depth == 1:
            self._began = time.process_time()
            _, most = resource.getrlimit(resource.RLIMIT_CPU)
            resource.setrlimit(resource.RLIMIT_CPU, (most, most))
            signal.alarm(_WAITING_SHARE * _MOST_COMPILING_S)

    @override
    def on_end(self, event: Any) -> None:
        self._depth -= 1
        if not self._depth:
            self._compiling_s += time.process_time() - self._began
            self._limit()

    def _limit(self) -> None:
        soft = self._seconds + math.ceil(self._compiling_s)
        hard = self._seconds + _MOST_COMPILING_S
        resource.setrlimit(resource.RLIMIT_CPU, (min(soft, hard), hard))
        signal.alarm(_WAITING_SHARE * self._seconds)


def _limit_memory(memory_mib: int) -> None:
    """Allow so much more than what is mapped now."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    most = pages * resource.getpagesize() + memory_mib * 2**20
    resource.setrlimit(resource.RLIMIT_AS, (most, most))
    resource.setrlimit(resource.RLIMIT_FSIZE, (memory_mib * 2**20, memory_mib * 2**20))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def _reason_against(folder: Path, task: dict[str, Any]) -> str:
    """Why the artifact in a folder cannot be served; empty if it can."""
    try:
        if task["result"] is None:
            _try(folder)
        else:
            _load(folder, task)
    except TaxelError as error:
        return str(error)
    except MemoryError:
        return f"{folder}: it needs more than {task['memory_mib']} MiB"
    except Exception as error:
        return f"{folder}: its runtime failed: {error!r}"
    return ""


def _load(folder: Path, task: dict[str, Any]) -> None:
    """Load it as a server does, and write the pickled model."""
    given = task["options"]
    options = RuntimeOptions(given["threads"], tuple(given["providers"]), given["network_program"])
    model = load_model(folder, options)
    with open(task["result"], "wb", closefd=False) as file:
        pickle.dump(model, file, protocol=5)


def _try(folder: Path) -> None:
    """Do what serving will do, but for compiling: open the model, evaluate it, lower its graph."""
    # Imported in this process alone: ONNX Runtime starts threads, which a fork would lose.
    from taxel_server.runtimes.onnx_models import OnnxRuntime

    artifact = artifacts.read(folder)
    check_graph(artifact.model_path)
    model = OnnxRuntime(artifact.model_path, artifact.manifest.normalisation)
    expected = len(artifact.manifest.normalisation.input_mean)
    if model.features != expected:
        raise ArtifactError(
            f"{artifact.model_path} takes {model.features} features, but its manifest names {expected}"
        )
    window = np.asarray(artifact.manifest.normalisation.input_mean, np.float32)
    for rows in ROWS:
        model.evaluate(np.tile(window, (rows, 1)))
    with suppress(Unsupported):
        lower(read_graph(artifact.model_path))


if __name__ == "__main__":
    main()
