"""Control loops that ask several servers, and what is done to the servers meanwhile."""

import os
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from threading import Event, Thread
from typing import Any, Final

import numpy as np

import taxel
from taxel.errors import RequestError
from taxel.remote import RemotePredictor
from taxel_bench.server_process import ADDRESS, free_port, start_server

_RATE_HZ: Final = 100.0


class Servers:
    """Servers of one repository, each at a port of its own that it keeps."""

    def __init__(self, repository: Path, count: int) -> None:
        self._repository = repository
        self.endpoints = [f"tcp/{ADDRESS}:{free_port()}" for _ in range(count)]
        self._processes: list[subprocess.Popen[str]] = []
        for endpoint in self.endpoints:
            self._processes.append(self._start(endpoint))

    def _start(self, endpoint: str) -> subprocess.Popen[str]:
        return start_server(self._repository, endpoint, "--lane", "off")

    def send(self, number: int, sign: signal.Signals) -> None:
        """Send a signal to a server."""
        os.kill(self._processes[number].pid, sign)

    def start_again(self, number: int) -> None:
        """Start a server whose process has been told to end; ready when this returns."""
        self._processes[number].communicate()
        self._processes[number] = self._start(self.endpoints[number])

    def close(self) -> None:
        """End all."""
        for process in self._processes:
            process.kill()
            process.communicate()


class Loops:
    """Control loops of 100 Hz, one thread each, which ask for one window in each step.

    Attributes:
        asked: when each request was due, and the seconds from then until its answer; guarded by nothing, as
            lists are.
        errors: what was raised, and when.
    """

    def __init__(self, predictor: RemotePredictor, count: int) -> None:
        self.asked: list[tuple[float, float]] = []
        self.errors: list[tuple[float, RequestError]] = []
        self._predictor = predictor
        self._window = np.asarray(predictor.manifest.typical_window, np.float32)[None]
        self._ends = Event()
        self._threads = [
            Thread(target=self._run, args=(number / count / _RATE_HZ,)) for number in range(count)
        ]

    def _run(self, offset: float) -> None:
        due = time.monotonic() + offset
        while not self._ends.wait(max(due - time.monotonic(), 0)):
            try:
                self._predictor.predict(self._window)
            except RequestError as error:
                self.errors.append((due, error))
            self.asked.append((due, time.monotonic() - due))
            due += 1 / _RATE_HZ

    @contextmanager
    def running(self) -> Iterator[None]:
        """Run them for a block."""
        for thread in self._threads:
            thread.start()
        try:
            yield
        finally:
            self._ends.set()
            for thread in self._threads:
                thread.join()

    def since(self, began: float) -> dict[str, Any]:
        """Figures of the requests that were due since a moment; times in ms."""
        took = np.array([seconds for due, seconds in list(self.asked) if due >= began]) * 1e3
        lost = [str(error) for due, error in list(self.errors) if due >= began]
        return {
            "requests": len(took),
            "lost": len(lost),
            "p50_ms": round(float(np.quantile(took, 0.5)), 2),
            "p99_ms": round(float(np.quantile(took, 0.99)), 2),
            "max_ms": round(float(took.max()), 1),
            "errors": sorted(set(lost))[:3],
        }


def measure(
    repository: Path, model: str, count: int, loops: int, seconds: float, note: Callable[[str], None]
) -> list[dict[str, Any]]:
    """What loops see while servers fail, one phase after the other.

    Args:
        repository: what is served.
        model: what is asked.
        count: how many servers.
        loops: how many control loops of 100 Hz.
        seconds: how long each phase lasts, at least.
        note: told each phase as it begins.
    """
    half = seconds / 2
    phases: list[dict[str, Any]] = []
    with ExitStack() as stack:
        servers = Servers(repository, count)
        stack.callback(servers.close)
        source = stack.enter_context(taxel.connect(servers.endpoints))

        def kill_one() -> None:
            servers.send(0, signal.SIGKILL)
            time.sleep(half)
            servers.start_again(0)

        def stop_one() -> None:
            servers.send(1, signal.SIGSTOP)
            time.sleep(half)
            servers.send(1, signal.SIGCONT)

        def restart_all() -> None:
            for number in range(count):
                servers.send(number, signal.SIGTERM)
                servers.start_again(number)
                time.sleep(1)

        asking = Loops(source.predictor(model), loops)
        with asking.running():
            time.sleep(1)
            for name, action in {
                "calm": lambda: None,
                "kill -9 one, start it again": kill_one,
                "SIGSTOP one, SIGCONT": stop_one,
                "rolling restart": restart_all,
            }.items():
                note(name)
                began, repeated = time.monotonic(), source.retries
                action()
                time.sleep(max(began + seconds - time.monotonic(), 0))
                told = asking.since(began)
                phases.append({"phase": name, **told, "repeated": source.retries - repeated})
    return phases
