"""The core: a repository's models behind one batcher. Any number of transports share it."""

from collections.abc import Callable
from typing import Any

from taxel.lane.offer import LaneOffer
from taxel.protocol import model_path
from taxel_server.core.batcher import Batcher
from taxel_server.core.jobs import Job
from taxel_server.core.metadata import ServerMetadata
from taxel_server.core.refusals import Refusals
from taxel_server.core.server_statistics import ServerStatistics
from taxel_server.engine import Engine, LoadedModel
from taxel_server.options import ServerOptions


class Core:
    """Admits, batches and answers requests between `start` and `drain`. Thread-safe.

    A transport finds a request's model with `model_at`, and gives it as a job to `run` or `submit`.

    Args:
        engine: its models are loaded and warmed up.
        options: the limits.
    """

    def __init__(self, engine: Engine, options: ServerOptions) -> None:
        self.max_request_rows = options.max_request_rows
        self.ready = False
        self.lane: LaneOffer | None = None
        """Where clients on this machine may ask, too."""
        self._drain_seconds = options.drain_seconds
        self._engine = engine
        self._routes: dict[str, LoadedModel] = {}
        self.refresh_routes()
        self.refusals = Refusals()
        self._batcher = Batcher(
            refusals=self.refusals,
            max_batch_rows=options.max_batch_rows,
            max_queue_rows=options.max_queue_rows,
            max_queue_requests=options.max_queue_requests,
        )
        self.statistics = ServerStatistics(engine, self._batcher, self.refusals)
        self._metadata = ServerMetadata(engine, lambda: self.ready, self.statistics, lambda: self.lane)
        self.model_at: Callable[[str], LoadedModel | None] = self._routes.get
        """The model of an inference request's path, such as `v2/models/xgb/infer`; None if it is none."""
        self.submit: Callable[[Job], None] = self._batcher.submit
        self.run: Callable[[Job], None] = self._batcher.run

    @property
    def progress(self) -> tuple[bool, int, int]:
        """Whether the worker runs, how many requests wait, and how many were answered since the start."""
        return self._batcher.is_alive, self._batcher.open_requests, self._batcher.answered

    @property
    def queued_rows(self) -> int:
        """Windows accepted and not yet answered."""
        return self._batcher.queued_rows

    def answer(self, path: str) -> dict[str, Any]:
        """The answer to a path that needs no evaluation, such as `v2/health/ready`.

        Raises:
            NotFound: no such path, model or version.
            Unavailable: the model cannot be loaded.
        """
        return self._metadata.answer(path)

    def refresh_routes(self) -> None:
        """Route requests to what the engine has loaded by now. A request under way keeps its model."""
        self._routes.update(_infer_routes(self._engine))

    def start(self) -> None:
        """Start the batcher's worker."""
        self._batcher.start()

    def drain(self) -> None:
        """Accept no more requests, and return when every accepted one has its answer.

        Requests that are not finished within `drain_seconds` are answered with `Unavailable`, and so are
        requests that arrive meanwhile.
        """
        self._batcher.stop(self._drain_seconds)
        self.ready = False
        self._batcher.join()

    def abandon(self) -> None:
        """Answer all open requests with `Unavailable`; for use if `drain` takes too long."""
        self._batcher.abandon()


def _infer_routes(engine: Engine) -> dict[str, LoadedModel]:
    """Every path of an inference request, and its model."""
    routes: dict[str, LoadedModel] = {}
    for loaded in engine.load_all():
        name, version = loaded.manifest.name, loaded.manifest.version
        routes[model_path(name, version, "infer")] = loaded
        routes[model_path(name, None, "infer")] = engine.model(name)
    return routes
