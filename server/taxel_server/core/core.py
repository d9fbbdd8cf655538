"""The core: a repository's models behind one batcher. Any number of transports share it."""

from collections.abc import Callable, Hashable, Iterable
from typing import Any

from taxel.lane.offer import LaneOffer
from taxel.protocol import model_path
from taxel_server.core.administration import Answer
from taxel_server.core.batcher import Batcher
from taxel_server.core.jobs import Job
from taxel_server.core.metadata import ServerMetadata
from taxel_server.core.policy import Ticket
from taxel_server.core.refusals import Refusals
from taxel_server.core.server_statistics import ServerStatistics
from taxel_server.core.traffic import Traffic
from taxel_server.engine import Engine, LoadedModel
from taxel_server.options import ServerOptions


class Core:
    """Admits, batches and answers requests between `start` and `drain`. Thread-safe.

    A transport finds a request's model with `model_at`, and gives it as a job to `run` or `submit`; or it
    answers a small request by itself, with what `evaluate_if_idle` gives.

    Args:
        engine: its models are loaded and warmed up.
        options: the limits.
    """

    def __init__(self, engine: Engine, options: ServerOptions) -> None:
        self.max_request_rows = options.max_request_rows
        self.ready = False
        self.lane: LaneOffer | None = None
        """Where clients on this machine may ask, too."""
        self.traffic: Traffic | None = None
        """Told each request, while somebody watches."""
        self._watched = Traffic(self._follow) if options.watchable else None
        self._drain_seconds = options.drain_seconds
        self._engine = engine
        engine.load_all()
        self._routes = _infer_routes(engine)
        self.refusals = Refusals()
        self.max_request_bytes = max(
            (_bytes_of(loaded, options.max_request_rows) for loaded in self._routes.values()), default=0
        )
        """Of the windows of the largest request."""
        self._batcher = Batcher(
            refusals=self.refusals,
            max_batch_rows=options.max_batch_rows,
            max_queue_rows=options.max_queue_rows,
            max_queue_requests=options.max_queue_requests,
            max_queue_bytes=max(options.max_queue_mib * 2**20, self.max_request_bytes),
            max_queue_seconds=options.max_queue_seconds,
        )
        self.statistics = ServerStatistics(engine, self._batcher, self.refusals)
        self._metadata = ServerMetadata(
            engine, lambda: self.ready, self.statistics, lambda: self.lane, self._watched
        )
        self.model_at: Callable[[str], LoadedModel | None] = self._routes.get
        """The model of an inference request's path, such as `v2/models/xgb/infer`; None if it is none."""
        self.submit: Callable[[Job], None] = self._batcher.submit
        self.run: Callable[[Job], None] = self._batcher.run
        self.evaluate_if_idle = self._batcher.evaluate_if_idle
        self.gone: Callable[[Hashable], None] = self._batcher.gone
        """Drops the requests of a connection or a session that has ended."""
        self.cancel: Callable[[Hashable], bool] = self._batcher.cancel
        """Drops the request of a name, which its client has given up; False if there is none open."""
        self.take_order: Callable[[str, bytes, Answer], bool] = lambda *_: False
        """Carries out an operator's order, and answers it once; False if the path is none."""
        self.check_room: Callable[[Ticket], None] = self._batcher.check_room
        """Raises if a request would be refused now: asked before its windows are read."""
        self.wait_until_idle: Callable[[float], bool] = self._batcher.wait_until_idle
        """Returns once nothing waits, at the latest after so many seconds: whether nothing waits."""
        self.run_delay: Callable[[], float | None] = self._batcher.run_delay
        """Seconds that the worker was ready to run and waited for a processor; None if nobody tells."""

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

    def refresh_routes(self) -> bool:
        """Route requests to what the engine has loaded by now. A request under way keeps its model.

        Returns:
            Whether nothing is left of versions that are not routed any more. Else call it again a little
            later: they still answer requests.
        """
        routes = _infer_routes(self._engine)
        for path, new in routes.items():
            old = self._routes.get(path)
            if old is not None and old is not new and old.label == new.label:
                self._batcher.succeed(old, new)
        self._routes.update(routes)
        self._batcher.shadows.set(_shadows_of(self._engine, routes.values()))
        for path in self._routes.keys() - routes.keys():
            del self._routes[path]
        return self._batcher.keep(routes.values())

    def _follow(self, follows: bool) -> None:
        """Take requests by a way that tells them to the traffic, or again without it."""
        traffic = self._watched if follows else None
        self.traffic = traffic
        self.submit = _seen_by(traffic, self._batcher.submit) if traffic else self._batcher.submit
        self.run = _seen_by(traffic, self._batcher.run) if traffic else self._batcher.run

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
        self._batcher.shadows.close()

    def abandon(self) -> None:
        """Answer all open requests with `Unavailable`; for use if `drain` takes too long."""
        self._batcher.abandon()


def _seen_by(traffic: Traffic, take: Callable[[Job], None]) -> Callable[[Job], None]:
    def taken(job: Job) -> None:
        job.seen = traffic.see
        take(job)

    return taken


def _infer_routes(engine: Engine) -> dict[str, LoadedModel]:
    """Every path of an inference request, and its model."""
    routes: dict[str, LoadedModel] = {}
    for loaded in engine.loaded():
        name, version = loaded.manifest.name, loaded.manifest.version
        routes[model_path(name, version, "infer")] = loaded
        if (newest := engine.newest(name)) is not None:
            routes[model_path(name, None, "infer")] = newest
    return routes


def _shadows_of(engine: Engine, models: Iterable[LoadedModel]) -> dict[LoadedModel, list[LoadedModel]]:
    """The shadows of each model's newest version, as far as they take the same windows."""
    newest = {found for name in {model.manifest.name for model in models} if (found := engine.newest(name))}
    return {
        model: [
            shadow
            for shadow in engine.shadows(model.manifest.name)
            if shadow.manifest.window.features == model.manifest.window.features
        ]
        for model in newest
    }


def _bytes_of(model: LoadedModel, rows: int) -> int:
    return rows * len(model.manifest.window.features) * 4
