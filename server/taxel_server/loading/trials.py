"""Trials: another process tries artifacts out that could compute without end, or loads them for us."""

import json
import os
import pickle
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict
from pathlib import Path
from signal import SIGKILL
from threading import Lock
from typing import Final, NamedTuple

from taxel.errors import ArtifactError, TaxelError
from taxel.manifest import Platform
from taxel_server.engine import LoadedModel, load_model
from taxel_server.runtimes import RuntimeOptions

TRIED: Final[frozenset[Platform]] = frozenset({"onnxruntime_onnx"})
"""Platforms whose files are programs. A tree's computation is bounded by its file's size."""

TRIAL_NEEDS: Final = ("numba", "onnx", "onnxruntime")
"""What a trial imports. Where one is missing, loading tells what to install."""

POSSIBLE: Final = sys.platform == "linux"
"""Whether this system can limit the time and memory of a forked process as is needed here."""

_SWITCH_S: Final = 0.0002
"""While a model is read here, other threads get the interpreter after so many seconds."""

_ONE_THREAD: Final = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")
"""A fork keeps only the thread that forks."""


class Verdict(NamedTuple):
    """What became of one trial.

    Attributes:
        folder: of the artifact.
        reason: why it may not be loaded; empty if it may, None if its trial has just begun.
    """

    folder: Path
    reason: str | None


class Trials:
    """Tries artifacts out, each in a process with a time and a memory limit.

    Args:
        seconds: of the processor that one may take; by the clock, ten times as long.
        memory_mib: how much it may allocate.
    """

    def __init__(self, seconds: int, memory_mib: int) -> None:
        self._seconds = seconds
        self._memory_mib = memory_mib
        self._processes: set[subprocess.Popen[bytes]] = set()
        self._closed = False
        self._lock = Lock()
        self._reading = Lock()

    def run(self, folders: Sequence[Path]) -> Iterator[Verdict]:
        """Start at once, and give a verdict when each trial begins and when it ends, as they come."""
        if not POSSIBLE or not folders:
            return iter([Verdict(folder, "") for folder in folders])
        try:
            process = self._start(folders)
        except OSError as error:
            return iter([Verdict(folder, f"it could not be tried out: {error}") for folder in folders])
        if process is None:
            return iter([Verdict(folder, "the server is stopping") for folder in folders])
        return self._verdicts(process, folders)

    def close(self) -> None:
        """End what is under way."""
        with self._lock:
            self._closed = True
            for process in self._processes:
                self._end(process)

    def load(self, folder: Path, options: RuntimeOptions) -> LoadedModel:
        """Load an artifact, as `load_model` does, but in another process: this one reads the result.

        Raises:
            TaxelError: it cannot be loaded, or not within the limits; the text says why.
        """
        if not POSSIBLE:
            return load_model(folder, options)
        with os.fdopen(os.memfd_create(f"taxel {folder.name}"), "rb") as file:
            process = self._start([folder], file.fileno(), options)
            if process is None:
                raise TaxelError("the server is stopping")
            reason = None
            for verdict in self._verdicts(process, [folder]):
                reason = verdict.reason
            if reason:
                raise ArtifactError(reason)
            # The other process has moved the place at which both read and write.
            file.seek(0)
            with self._reading, _often_switching():
                model = pickle.load(file)
        assert isinstance(model, LoadedModel)
        return model

    def _start(
        self, folders: Sequence[Path], result: int | None = None, options: RuntimeOptions | None = None
    ) -> "subprocess.Popen[bytes] | None":
        task = {
            "folders": [str(folder) for folder in folders],
            "seconds": self._seconds,
            "memory_mib": self._memory_mib,
            "at_once": max(2, os.cpu_count() or 1),
            "result": result,
            "options": options and asdict(options),
        }
        with self._lock:
            if self._closed:
                return None
            # A session of its own: the terminal's signals are the server's business, and all its processes
            # can be killed together. -P: the working folder holds no modules of ours.
            process = subprocess.Popen(
                [sys.executable, "-P", "-m", "taxel_server.loading.trial_process"],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                env=os.environ | _ONE_THREAD,
                start_new_session=True,
                pass_fds=() if result is None else (result,),
            )
            self._processes.add(process)
        assert process.stdin is not None
        with suppress(BrokenPipeError), process.stdin as pipe:
            pipe.write(json.dumps(task).encode())
        return process

    def _verdicts(self, process: "subprocess.Popen[bytes]", folders: Sequence[Path]) -> Iterator[Verdict]:
        left = {str(folder) for folder in folders}
        assert process.stdout is not None
        with process.stdout:
            for line in process.stdout:
                told = json.loads(line)
                if "reason" in told:
                    left.discard(told["folder"])
                yield Verdict(Path(told["folder"]), told.get("reason"))
        code = process.wait()
        with self._lock:
            self._processes.discard(process)
        for folder in sorted(left):
            yield Verdict(
                Path(folder), f"{folder}: it was not tried out: that process ended with code {code}"
            )

    def _end(self, process: "subprocess.Popen[bytes]") -> None:
        if process.poll() is None:
            with suppress(ProcessLookupError):
                os.killpg(process.pid, SIGKILL)
            process.wait()


@contextmanager
def _often_switching() -> Iterator[None]:
    """Let other threads have the interpreter soon."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(_SWITCH_S)
    try:
        yield
    finally:
        sys.setswitchinterval(before)
