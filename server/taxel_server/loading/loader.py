"""The loader: a thread that loads a repository's models, at the start and when it is told to look again."""

import logging
import time
from collections.abc import Callable
from pathlib import Path
from threading import Condition, Thread
from typing import Final

from taxel import artifacts
from taxel.dependencies import require
from taxel.errors import TaxelError
from taxel_server.engine import Engine, LoadedModel, Place
from taxel_server.loading.trials import TRIAL_NEEDS, TRIED, Trials

_LOG: Final = logging.getLogger(__name__)

_PATIENCE_S: Final = 2.0
_PATIENCE_SHARE: Final = 0.5
"""How long the start waits for trials when nothing else is left to load: at least the first, and this share
of the time until then."""

_WAITING: Final = "it waits to be loaded"
_ON_TRIAL: Final = "it is being tried out in a process of its own; it joins if it answers in time"


class Loader:
    """Loads versions beside those that are served. Nothing waits for a version that takes unusually long.

    Args:
        engine: whose repository is loaded.
        trials: tries out artifacts that could compute without end.
    """

    def __init__(self, engine: Engine, trials: Trials) -> None:
        self._engine = engine
        self._trials = trials
        self._changed: Callable[[], None] = lambda: None
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
        self.counts = {"loaded": 0, "refused": 0}
        """Versions by what became of them, over all loads."""
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
        return self._done >= self._asked

    def watch(self, changed: Callable[[], None]) -> None:
        """Call a function, in the loader's thread, whenever versions have been loaded; and once now."""
        self._changed = changed
        changed()

    def reload(self) -> None:
        """Load what is new in the repository, and what was refused before; returns at once."""
        with self._condition:
            self._asked += 1
            self._condition.notify_all()

    def close(self) -> None:
        """Load no more."""
        with self._condition:
            self._closed = True
            self._condition.notify_all()
        self._trials.close()

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
        while True:
            with self._condition:
                self._condition.wait_for(lambda: self._closed or self._asked > self._done)
                if self._closed:
                    return
                # Whatever was asked for until now is answered by one look.
                answered = self._asked
            try:
                self._load_what_is_new()
            except Exception:
                # A repository that has gone must not end the server.
                _LOG.exception("the repository could not be read")
            with self._condition:
                self._done = answered
                self._condition.notify_all()

    def _load_what_is_new(self) -> None:
        places = self._engine.scan(hold=_WAITING)
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
        self._changed()
        self._note_progress(computing=False)
