"""Exchanges versions while a server answers: loads one beside the others, then switches in one step."""

import logging
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from threading import Lock
from typing import Final

from taxel import artifacts
from taxel.errors import NotFound, RequestError, TaxelError, Unavailable
from taxel_server.engine import Engine, LoadedModel, Place
from taxel_server.loading.trials import Trials

_LOG: Final = logging.getLogger(__name__)

AT_ONCE: Final = 2
"""Versions that are loaded at the same time: one that never ends must not hold up all others."""

LOADING: Final = "it is being loaded"
"""Why a version is not there yet."""

_STOPPING: Final = "the server is stopping"

Done = Callable[[RequestError | None], None]
"""Called once with None, or with the reason why a version was not loaded."""


class Exchange:
    """Loads and unloads versions. Thread-safe.

    Args:
        engine: that serves them.
        trials: in whose processes they are loaded.

    Attributes:
        counts: versions by what became of them.
        changed: called after each change of what is served.
    """

    def __init__(self, engine: Engine, trials: Trials) -> None:
        self._engine = engine
        self._trials = trials
        self._lock = Lock()
        self._under_way: dict[Place, list[Done]] = {}
        """Who is to be told what became of a version."""
        self._closed = False
        self._pool = ThreadPoolExecutor(AT_ONCE, "taxel-exchange")
        self.counts = {"loaded": 0, "refused": 0, "unloaded": 0}
        self.changed: Callable[[], None] = lambda: None

    @property
    def is_idle(self) -> bool:
        """Whether nothing is being loaded."""
        return not self._under_way

    def load(self, place: Place, done: Done = lambda _: None, *, shadow: bool = False) -> None:
        """Load a version beside what is served; returns at once.

        Args:
            place: of the version.
            done: told when it is served, or refused.
            shadow: whether it answers only copies of requests.
        """
        with self._lock:
            if self._closed:
                refusal: RequestError | None = Unavailable(_STOPPING)
            elif place in self._under_way:
                self._under_way[place].append(done)
                return
            else:
                refusal = None
                self._under_way[place] = [done]
                self._pool.submit(self._load, place, shadow)
        if refusal is not None:
            done(refusal)

    def unload(self, place: Place) -> None:
        """Serve a version no more. Requests that have it are still answered.

        Raises:
            NotFound: it is not loaded.
        """
        self._engine.unload(place)
        self._count("unloaded")
        self.changed()

    def close(self) -> None:
        """Load no more; what is under way is refused."""
        with self._lock:
            self._closed = True
        self._trials.close()
        self._pool.shutdown()

    def _load(self, place: Place, shadow: bool) -> None:
        reason = ""
        try:
            reason = self._reason_against(place, shadow)
        except Exception as error:
            _LOG.exception("model %s/%s is unavailable", *place)
            reason = f"its runtime failed: {error!r}"
        if reason and not self._closed:
            self._engine.refuse(place, reason)
        self._count("refused" if reason else "loaded")
        self.changed()
        with self._lock:
            waiting = self._under_way.pop(place)
        for done in waiting:
            try:
                done(Unavailable(reason) if reason else None)
            except Exception:
                _LOG.exception("an answer could not be given")

    def _count(self, outcome: str) -> None:
        with self._lock:
            self.counts[outcome] += 1

    def _reason_against(self, place: Place, shadow: bool) -> str:
        """Load a version and serve it; or say why not."""
        before = self._engine.outcome(place)
        if not isinstance(before, LoadedModel):
            self._engine.hold([place], LOADING)
        try:
            model = self._trials.load(self._engine.folder(place), self._engine.options)
        except TaxelError as error:
            return str(error)
        if isinstance(before, LoadedModel) and before.manifest != model.manifest:
            return (
                "its manifest has changed since it was loaded: expected a new version, or this one unloaded"
            )
        if shadow and (fault := self._fault_as_shadow(model)):
            return fault
        self._engine.put(place, model, shadow=shadow)
        return ""

    def _fault_as_shadow(self, model: LoadedModel) -> str:
        newest = self._engine.newest(model.manifest.name)
        if newest is None:
            return "a shadow needs another version beside it, which answers"
        if newest.manifest.window.features != model.manifest.window.features:
            return f"its windows are not those of {newest.label}, whose requests it would get"
        return ""


def place_of(engine: Engine, name: str, version: str | None) -> Place:
    """The place of a version in an engine's repository; the newest one there, if none is named.

    Raises:
        NotFound: there is none.
    """
    repository = engine.folder((name, "0")).parent.parent
    try:
        folder = artifacts.folder_of(repository, name, version)
    except TaxelError as error:
        raise NotFound(str(error)) from None
    return name, folder.name
