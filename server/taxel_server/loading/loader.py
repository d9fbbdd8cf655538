"""The loader: a thread that loads a repository's models at the start, and then looks for new ones."""

import logging
import time
from collections.abc import Callable
from pathlib import Path
from threading import Condition, Thread
from typing import Final

from taxel import artifacts
from taxel.dependencies import require
from taxel.errors import TaxelError
from taxel_server.engine import UNLOADED, Engine, LoadedModel, Place
from taxel_server.loading.exchange import Exchange
from taxel_server.loading.folder_state import FolderState, folder_state
from taxel_server.loading.trials import TRIAL_NEEDS, TRIED, Trials

_LOG: Final = logging.getLogger(__name__)

_PATIENCE_S: Final = 2.0
_PATIENCE_SHARE: Final = 0.5
"""How long the start waits for trials when nothing else is left to load: at least the first, and this share
of the time until then."""

_SETTLE_S: Final = 1.0
"""How long requests for a version that is served no more have to end, before it is looked at again."""

_WAITING: Final = "it waits to be loaded"
_ON_TRIAL: Final = "it is being tried out in a process of its own; it joins if it answers in time"


class Loader:
    """Loads versions beside those that are served. Nothing waits for a version that takes unusually long.

    At the start, this process loads the models itself. Later, other processes do.

    Args:
        engine: whose repository is loaded.
        trials: tries out artifacts that could compute without end.
        watch_seconds: how often it looks for new versions; 0 for never.

    Attributes:
        exchange: loads single versions once everything was loaded.
        counts: versions by what became of them, over all loads.
    """

    def __init__(self, engine: Engine, trials: Trials, watch_seconds: float = 0.0) -> None:
        self._engine = engine
        self._trials = trials
        self._watch_seconds = watch_seconds
        self.exchange = Exchange(engine, trials)
        self._changed: Callable[[], bool] = lambda: True
        self._settled = True
        """Whether nothing is left of versions that are served no more."""
        self._seen: dict[Place, FolderState] = {}
        """Folders as they were at the last look."""
        self._tried: dict[Place, FolderState] = {}
        """Folders as they were when their version was loaded or refused."""
        self._condition = Condition()
        self._asked = 0
        """How often loading was asked for."""
        self._done = 0
        self._closed = False
        self._computing = True
        """Whether this process loads a model."""
        self._trials_begin = False
        """Whether the process of the trials has not said anything yet."""
        self._started = self._progressed = time.monotonic()
        self.counts = self.exchange.counts
        self._thread = Thread(target=self._run, name="taxel-loader", daemon=True)

    def start(self) -> None:
        """Start the thread, which loads everything."""
        self._asked = 1
        self._thread.start()

    def wait(self) -> None:
        """Return when everything has been loaded or refused, or when only slow trials are left.

        A trial is slow if nothing else has happened for half as long as all before it took, and 2 s. There
        is always a model that was loaded, unless none can be.
        """
        with self._condition:
            while not self._done and not self._is_slow():
                self._condition.wait(0.1)

    @property
    def is_idle(self) -> bool:
        """Whether everything that was asked for is done."""
        return self._done >= self._asked and self.exchange.is_idle

    @property
    def served(self) -> int:
        """How many versions are served."""
        return len(self._engine.loaded())

    def watch(self, changed: Callable[[], bool]) -> None:
        """Call a function whenever what is served has changed, and once now.

        Args:
            changed: on any thread; it returns False if it is to be called again a little later.
        """
        self._changed = changed
        self.exchange.changed = self._tell
        self._tell()

    def reload(self) -> None:
        """Load what is new in the repository, and what was refused before; returns at once.

        What was unloaded stays so.
        """
        with self._condition:
            self._asked += 1
            self._condition.notify_all()

    def close(self) -> None:
        """Load no more."""
        with self._condition:
            self._closed = True
            self._condition.notify_all()
        self.exchange.close()

    def _tell(self) -> None:
        self._changed()
        with self._condition:
            self._settled = False
            self._condition.notify_all()

    def _is_slow(self) -> bool:
        taken = self._progressed - self._started
        busy = self._computing or self._trials_begin or not self.counts["loaded"]
        return not busy and time.monotonic() - self._progressed > max(_PATIENCE_S, _PATIENCE_SHARE * taken)

    def _note_progress(self, computing: bool) -> None:
        with self._condition:
            self._computing = computing
            self._progressed = time.monotonic()
            self._condition.notify_all()

    def _run(self) -> None:
        pause_s = self._watch_seconds or _SETTLE_S
        while True:
            with self._condition:
                self._condition.wait_for(lambda: self._closed or self._asked > self._done, pause_s)
                if self._closed:
                    return
                # Whatever was asked for until now is answered by one look.
                answered = self._asked
            try:
                if not self._done:
                    self._load_everything()
                elif answered > self._done or self._watch_seconds:
                    self._look(again=answered > self._done)
                self._settled = self._settled or self._changed()
            except OSError as error:
                # A repository that has gone, or files that are used up, must not end the server.
                _LOG.error("the repository could not be read: %s", error)
            except Exception:
                _LOG.exception("the repository could not be read")
            with self._condition:
                self._done = answered
                self._condition.notify_all()

    def _look(self, *, again: bool) -> None:
        """Load versions that are new, or whose folder has changed since they were refused.

        A folder that changes still, as somebody copies files into it, is left until the next look.

        Args:
            again: load all that were refused, at once.
        """
        states = {}
        for place in self._engine.scan(hold=_WAITING):
            states[place] = state = folder_state(self._engine.folder(place))
            if self._engine.outcome(place) == UNLOADED:
                continue
            steady = state == self._seen.get(place) and state != self._tried.get(place)
            if again or steady:
                self._tried[place] = state
                self.exchange.load(place)
        self._seen = states

    def _load_everything(self) -> None:
        places = self._engine.scan(hold=_WAITING)
        self._tried = {place: folder_state(self._engine.folder(place)) for place in places}
        suspects = {str(self._engine.folder(place)): place for place in places if self._needs_trial(place)}
        self._engine.hold(suspects.values(), _ON_TRIAL)
        others = [place for place in places if place not in suspects.values()]
        self._trials_begin = bool(suspects)
        verdicts = self._trials.run([Path(folder) for folder in suspects])
        for place in others:
            self._load(place)
        for folder, reason in verdicts:
            self._trials_begin = False
            if reason is None:
                self._note_progress(computing=False)
            elif not reason:
                self._load(suspects[str(folder)])
            elif not self._closed:
                self._engine.refuse(suspects[str(folder)], reason)
                self.counts["refused"] += 1
                self._note_progress(computing=False)

    def _needs_trial(self, place: Place) -> bool:
        """Whether a version is sound, and of a platform whose files could compute without end."""
        try:
            require("a trial", "server", *TRIAL_NEEDS)
            return artifacts.read(self._engine.folder(place)).manifest.platform in TRIED
        except TaxelError:
            return False

    def _load(self, place: Place) -> None:
        if self._closed:
            return
        self._note_progress(computing=True)
        outcome = self._engine.load(place)
        self.counts["loaded" if isinstance(outcome, LoadedModel) else "refused"] += 1
        self._tell()
        self._note_progress(computing=False)
