"""A server or a client in processes of its own, with what they use and say."""

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import psutil

from taxel.errors import SettingsError, Unavailable

_PATIENCE_S: Final = 10.0
"""How long a process that was told to stop may take before it is killed."""

_DESCENDANTS_S: Final = 1.0
"""How long what it has started may live on."""

_KEEP: Final = """
import os, sys
os.sched_setaffinity(0, map(int, sys.argv[1].split(",")))
os.execvp(sys.argv[2], sys.argv[2:])
"""
"""Keeps this process on some cores, and becomes another program."""


@dataclass(frozen=True)
class Cores:
    """Which processor cores servers may use, and which clients."""

    servers: frozenset[int]
    clients: frozenset[int]

    @classmethod
    def apart(cls) -> "Cores":
        """One core of this process's for clients, the others for servers.

        Raises:
            SettingsError: there is only one, or the system does not let processes be kept on some.
        """
        if sys.platform != "linux":
            raise SettingsError("--pin: expected Linux, which lets a process be kept on some cores")
        *servers, client = sorted(os.sched_getaffinity(0))
        if not servers:
            raise SettingsError("--pin: there is one core: expected at least two")
        return cls(frozenset(servers), frozenset([client]))


class Program:
    """A running program and whatever processes it has started; made by `running_program`."""

    def __init__(self, process: subprocess.Popen[str], log: Path) -> None:
        self._popen = process
        self._process = psutil.Process(process.pid)
        self._log = log

    @property
    def runs(self) -> bool:
        """Whether it has not ended."""
        return self._popen.poll() is None

    def cpu_seconds(self) -> float:
        """Processor time so far of all its processes that live."""
        total = 0.0
        for process in [self._process, *self._process.children(recursive=True)]:
            try:
                times = process.cpu_times()
            except psutil.NoSuchProcess:
                continue
            total += times.user + times.system
        return total

    def request(self, **what: Any) -> dict[str, Any]:
        """Write one line of JSON to it and wait for the line that it answers.

        Raises:
            Unavailable: it ended instead.
        """
        assert self._popen.stdin is not None
        assert self._popen.stdout is not None
        try:
            self._popen.stdin.write(json.dumps(what) + "\n")
            self._popen.stdin.flush()
        except BrokenPipeError:
            raise Unavailable(self.last_log_line()) from None
        line = self._popen.stdout.readline()
        if not line:
            raise Unavailable(self.last_log_line())
        answer: dict[str, Any] = json.loads(line)
        return answer

    def last_log_line(self) -> str:
        """The last line that it has written for people."""
        lines = self._log.read_text(encoding="utf-8", errors="replace").strip().splitlines()
        return lines[-1].strip() if lines else "it ended without a word"


@contextmanager
def running_program(
    command: Sequence[str],
    *,
    path: Path | None = None,
    takes_requests: bool = False,
    cores: frozenset[int] | None = None,
) -> Iterator[Program]:
    """Start a program; when the block ends, it and all that it has started end, too.

    Args:
        command: with its arguments, all paths absolute.
        path: where its interpreter looks for modules first.
        takes_requests: whether its stdout answers `request`; else whatever it prints is as stderr.
        cores: that it is kept on; None for any.
    """
    if cores is not None:
        command = [sys.executable, "-c", _KEEP, ",".join(map(str, cores)), *command]
    environment = dict(os.environ) if path is None else {**os.environ, "PYTHONPATH": str(path)}
    with tempfile.TemporaryDirectory(prefix="taxel-compare-") as folder:
        log = Path(folder) / "log"
        with log.open("wb") as stream:
            process = subprocess.Popen(
                command,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE if takes_requests else stream,
                stderr=stream,
                text=True,
                cwd=folder,
                env=environment,
                # A Ctrl-C of the terminal reaches this process alone, which ends the others.
                start_new_session=True,
            )
        try:
            yield Program(process, log)
        finally:
            _end(process)


def _end(process: subprocess.Popen[str]) -> None:
    try:
        descendants = psutil.Process(process.pid).children(recursive=True)
    except psutil.NoSuchProcess:
        descendants = []
    process.terminate()
    try:
        process.wait(_PATIENCE_S)
    except subprocess.TimeoutExpired:
        process.kill()
    process.communicate()
    _, left = psutil.wait_procs(descendants, timeout=_DESCENDANTS_S)
    for survivor in left:
        with suppress(psutil.NoSuchProcess):
            survivor.kill()
    psutil.wait_procs(left, timeout=_PATIENCE_S)
