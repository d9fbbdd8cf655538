"""The memory transport: a server in this process, for tests and for embedding, without any socket.

    with MemoryServer(repository) as server, taxel.connect(transport=server) as source:
        predictor = source.predictor("xgb")

Requests take the same way as those of other transports: the same messages, admission, batcher, statistics
and errors. A lone window is evaluated in the thread that asks.
"""

import os
from collections.abc import Callable
from pathlib import Path
from queue import Empty, SimpleQueue
from types import TracebackType
from typing import ClassVar, Final, Literal, Self

from typing_extensions import override

from taxel.envelopes import RequestReader
from taxel.errors import DeadlineExceeded, InvalidArgument, RequestError, Unavailable
from taxel.local import shipped_repository
from taxel.protocol import (
    InferRequest,
    InferResponse,
    pack_error,
    pack_infer_response,
    packb,
    unpack_error,
)
from taxel.remote.query_transport import Done, QueryTransport
from taxel_server.core.core import Core
from taxel_server.core.jobs import Job
from taxel_server.engine import Engine, LoadedModel
from taxel_server.options import ServerOptions

_DEFAULTS: Final = ServerOptions()


class MemoryJob(Job):
    """An inference query of this process."""

    def __init__(
        self,
        payload: bytes,
        model: LoadedModel,
        rows: int,
        reader: RequestReader,
        done: Done,
        name: object,
    ) -> None:
        super().__init__(model, rows, len(payload), name=name)
        self._payload = payload
        self._reader = reader
        self._done = done

    @override
    def decode(self) -> InferRequest:
        request = self._reader.read(self._payload)
        self.traceparent = request.traceparent
        return request

    @override
    def answer(self, result: InferResponse | RequestError) -> None:
        self._done(
            _as_received(result) if isinstance(result, RequestError) else pack_infer_response(result)
        )


class MemoryServer(QueryTransport):
    """A server that answers from `serve` until `close`, or within `with`. Thread-safe.

    It is the transport of any number of sources, which do not close it.

    Args:
        repository: a folder of artifacts, or an engine; if none, the models that come with Taxel.
        options: the limits and the prefix of all keys; where to listen is ignored.

    Raises:
        ArtifactError: the repository is no folder.
        InvalidArgument: the repository or the options have the wrong type.
    """

    name: ClassVar[Literal["zenoh", "memory"]] = "memory"

    def __init__(
        self, repository: Engine | Path | str | None = None, options: ServerOptions = _DEFAULTS
    ) -> None:
        if not isinstance(options, ServerOptions):
            raise InvalidArgument(f"options is {options!r}: expected ServerOptions")
        if not isinstance(repository, (Engine, Path, str, type(None))):
            raise InvalidArgument(f"repository is {repository!r}: expected a folder's path or an engine")
        if isinstance(repository, Engine):
            engine = repository
        else:
            engine = Engine(shipped_repository() if repository is None else Path(repository))
        self.endpoint = "memory"
        self._prefix = f"{options.prefix}/"
        self._core = Core(engine, options)
        self._reader = RequestReader(self._core.max_request_rows)
        self._process = os.getpid()
        self._open = False

    @property
    @override
    def connected(self) -> bool:
        return self._open

    @property
    def queued_rows(self) -> int:
        """Windows accepted and not yet answered."""
        return self._core.queued_rows

    def serve(self) -> Self:
        """Answer queries from now on."""
        self._core.start()
        self._core.ready = self._open = True
        return self

    @override
    def start(
        self, key: str, payload: bytes | None, timeout: float, cancel_key: str | None = None
    ) -> Callable[[], bytes]:
        arrived: SimpleQueue[bytes | RequestError] = SimpleQueue()
        self._take(key, payload, arrived.put, self._core.run, arrived)

        def answer() -> bytes:
            try:
                outcome = arrived.get(timeout=timeout)
            except Empty:
                self._core.cancel(arrived)
                raise DeadlineExceeded(f"memory: no answer to {key} within {timeout:g} s") from None
            if isinstance(outcome, RequestError):
                raise outcome
            return outcome

        return answer

    @override
    def send(
        self, key: str, payload: bytes | None, timeout: float, done: Done, cancel_key: str | None = None
    ) -> Callable[[], None]:
        # An event loop must not wait for an evaluation: the batcher's worker does it.
        name = object()
        self._take(key, payload, done, self._core.submit, name)

        def give_up() -> None:
            self._core.cancel(name)

        return give_up

    @override
    def silence(self, key: str) -> RequestError:
        return Unavailable(f"memory: nobody answers {key}: expected an open server with this prefix")

    @override
    def close(self) -> None:
        """Accept no more queries, and return when every accepted one has its answer."""
        if self._open:
            self._open = False
            self._core.drain()

    def __enter__(self) -> Self:
        return self.serve()

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def _take(
        self, key: str, payload: bytes | None, done: Done, infer: Callable[[Job], None], name: object
    ) -> None:
        if not (self._open and self._process == os.getpid() and key.startswith(self._prefix)):
            done(self.silence(key))
            return
        path = key[len(self._prefix) :]
        model = self._core.model_at(path)
        try:
            if model is None:
                done(packb(self._core.answer(path)))
                return
            payload = payload or b""
            rows = self._reader.rows_in(len(payload), len(model.manifest.window.features))
            infer(MemoryJob(payload, model, rows, self._reader, done, name))
        except RequestError as error:
            done(_as_received(error))


def _as_received(error: RequestError) -> RequestError:
    """An error as a client reads it from the wire."""
    return unpack_error(pack_error(error))
