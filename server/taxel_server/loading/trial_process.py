"""The process in which artifacts are tried out; `trials.py` starts it.

It forks a process for each artifact. The kernel kills this process when its time is over, whatever it
computes. What it may allocate is limited, too. So a model that never answers harms nobody.
"""

import json
import os
import resource
import signal
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

import numpy as np

from taxel import artifacts
from taxel.errors import ArtifactError, TaxelError
from taxel_server.runtimes.graph_checks import check_graph
from taxel_server.runtimes.networks.graph import Unsupported, read_graph
from taxel_server.runtimes.networks.lowering import lower

ROWS: Final = (1, 8, 64, 512)
"""Windows of the evaluations that are tried."""

_TOO_LONG: Final = (signal.SIGXCPU, signal.SIGALRM)
"""What the kernel kills with when the processor's time is over, and when that of the clock is."""

_WAITING_SHARE: Final = 10
"""How much longer a trial may take by the clock."""

_LONGEST_REASON: Final = 1500
"""Characters; a line of the pipe must fit into one write."""


def main() -> None:
    """Try the artifacts that stdin names, and print two lines of JSON for each."""
    task = json.load(sys.stdin)
    waiting: list[str] = task["folders"]
    running: dict[int, str] = {}
    while waiting or running:
        while waiting and len(running) < task["at_once"]:
            folder = waiting.pop(0)
            _tell(folder=folder, started=True)
            running[_fork(Path(folder), task["seconds"], task["memory_mib"])] = folder
        process, status = os.wait()
        folder = running.pop(process)
        if os.WIFSIGNALED(status):
            _tell(folder=folder, reason=_death(os.WTERMSIG(status), task))
        elif os.WEXITSTATUS(status):
            _tell(folder=folder, reason=f"its trial ended with code {os.WEXITSTATUS(status)}")


def _tell(**fields: Any) -> None:
    os.write(1, (json.dumps(fields) + "\n").encode())


def _death(number: int, task: dict[str, Any]) -> str:
    if number in _TOO_LONG:
        return f"its trial took longer than {task['seconds']} s: expected a model that answers at once"
    return (
        f"its trial died with {signal.Signals(number).name}: it may need more than {task['memory_mib']} MiB"
    )


def _fork(folder: Path, seconds: int, memory_mib: int) -> int:
    process = os.fork()
    if process:
        return process
    code = 1
    try:
        # Nothing handles these signals, so that they kill, even in the middle of a library's computation.
        for number in _TOO_LONG:
            signal.signal(number, signal.SIG_DFL)
        # A busy machine makes a trial slow, not wrong: the processor's time counts.
        resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 1))
        signal.alarm(_WAITING_SHARE * seconds)
        _limit_memory(memory_mib)
        # ONNX Runtime logs what fails, which the reason says, too.
        os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
        _tell(folder=str(folder), reason=_reason_against(folder, memory_mib)[:_LONGEST_REASON])
        code = 0
    finally:
        os._exit(code)


def _limit_memory(memory_mib: int) -> None:
    """Allow so much more than what is mapped now."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    most = pages * resource.getpagesize() + memory_mib * 2**20
    resource.setrlimit(resource.RLIMIT_AS, (most, most))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def _reason_against(folder: Path, memory_mib: int) -> str:
    """Why the artifact in a folder cannot be served; empty if it can."""
    try:
        _try(folder)
    except TaxelError as error:
        return str(error)
    except MemoryError:
        return f"{folder}: it needs more than {memory_mib} MiB"
    except Exception as error:
        return f"{folder}: its runtime failed: {error!r}"
    return ""


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
