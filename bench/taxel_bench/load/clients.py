"""The client processes of a run: started, set off together, and ended whatever happens."""

import multiprocessing
import signal
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess
from typing import Final, TypeVar

from taxel.errors import TaxelError
from taxel_bench.load.client import Finished, Ready, work
from taxel_bench.load.settings import LoadSettings

_HEAD_START_S: Final = 0.05
"""Between telling the clients when to start and the start."""

T = TypeVar("T", Ready, Finished)


class Clients:
    """Client processes that are ready to start; made by `ready_clients`."""

    def __init__(self, members: list[tuple[Connection, SpawnProcess]]) -> None:
        self._members = members

    def run(self) -> list[Finished]:
        """Set all off together and wait for what they report.

        Raises:
            TaxelError: one ended without a report.
        """
        start = time.perf_counter() + _HEAD_START_S
        for client, (pipe, _) in enumerate(self._members):
            try:
                pipe.send(start)
            except BrokenPipeError:
                raise self._ended(client) from None
        return self.hear(Finished)

    def hear(self, expected: type[T]) -> list[T]:
        """What each client says next.

        Raises:
            TaxelError: one could not do its work.
        """
        return [self._hear(client, expected) for client in range(len(self._members))]

    def _hear(self, client: int, expected: type[T]) -> T:
        try:
            said = self._members[client][0].recv()
        except (EOFError, ConnectionResetError):
            raise self._ended(client) from None
        if isinstance(said, TaxelError):
            raise said
        assert isinstance(said, expected)
        return said

    def _ended(self, client: int) -> TaxelError:
        process = self._members[client][1]
        process.join()
        return TaxelError(
            f"client process {client} ended before its work was done, with code {process.exitcode}"
        )


@contextmanager
def ready_clients(settings: LoadSettings, endpoint: str) -> Iterator[Clients]:
    """As many client processes as the settings ask for, connected and warm, until the block ends.

    Raises:
        Unavailable: nobody listens at the endpoint.
        NotFound: the server has no such model.
    """
    # Spawned, as a fork would take over locks of zenoh's threads.
    context = multiprocessing.get_context("spawn")
    members = []
    with ExitStack() as ending:
        for client in range(settings.clients):
            ours, theirs = context.Pipe()
            ending.enter_context(ours)
            process = context.Process(target=work, args=(theirs, endpoint, settings, client), daemon=True)
            with theirs, _interrupts_ignored():
                process.start()
            ending.callback(_end, process)
            members.append((ours, process))
        clients = Clients(members)
        clients.hear(Ready)
        yield clients


def _end(process: SpawnProcess) -> None:
    process.terminate()
    process.join()
    process.close()


@contextmanager
def _interrupts_ignored() -> Iterator[None]:
    """A process started meanwhile leaves Ctrl-C, which a terminal sends to all, to this one."""
    handler = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, handler)
