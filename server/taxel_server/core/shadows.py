"""Shadows: versions that answer copies of another version's requests. Their differences are counted.

Nobody waits for a shadow. It has a thread of its own that gives way to all others. What it cannot keep up
with is left out, and counted.
"""

import logging
import os
import sys
import threading
from collections.abc import Mapping, Sequence
from contextlib import suppress
from queue import SimpleQueue
from threading import Lock, Thread
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from taxel.channels import CHANNELS
from taxel_server.engine import LoadedModel

_LOG: Final = logging.getLogger(__name__)

_MOST_ROWS: Final = 4096
"""Windows that wait for shadows; further ones are left out."""

_DIFFERENT: Final = 1.0
"""Counts: a window whose channels all differ by less counts as the same."""

_NICE: Final = 10


class Comparison:
    """How a shadow's predictions differ from those of the version that answers. Thread-safe.

    Args:
        of: name and version of that version.
    """

    def __init__(self, of: str) -> None:
        self.of: Final = of
        self._lock = Lock()
        self._rows = {"same": 0, "different": 0, "failed": 0, "skipped": 0}
        self._sum = np.zeros(len(CHANNELS))
        self._most = np.zeros(len(CHANNELS))

    def add(self, answered: NDArray[np.float32], shadowed: NDArray[np.float32]) -> None:
        """Count predictions (n, 21) of both versions for the same windows."""
        difference = np.abs(shadowed.astype(np.float64) - answered)
        different = int((difference.max(axis=1) >= _DIFFERENT).sum())
        with self._lock:
            self._rows["different"] += different
            self._rows["same"] += len(answered) - different
            self._sum += difference.sum(axis=0)
            self._most = np.maximum(self._most, difference.max(axis=0))

    def leave_out(self, rows: int, why: str) -> None:
        """Count windows that the shadow `failed` at, or that were `skipped`."""
        with self._lock:
            self._rows[why] += rows

    def as_dict(self) -> dict[str, Any]:
        """As on the wire; differences are in counts, and `channel` is the one with the largest mean."""
        with self._lock:
            rows, total, most = dict(self._rows), self._sum.copy(), self._most.max()
        compared = rows["same"] + rows["different"]
        return {
            "of": self.of,
            "rows": rows,
            "mean_difference": float(total.mean() / compared) if compared else 0.0,
            "max_difference": float(most),
            "channel": CHANNELS[int(total.argmax())] if compared else "",
        }


class _Shadow(NamedTuple):
    model: LoadedModel
    comparison: Comparison


class Shadows:
    """Takes copies of requests and their answers, and evaluates them again.

    Attributes:
        shadowed: versions that have shadows.
    """

    def __init__(self) -> None:
        self.shadowed: Mapping[LoadedModel, Sequence[_Shadow]] = {}
        self._queue: SimpleQueue[
            tuple[Sequence[_Shadow], NDArray[np.float32], NDArray[np.float32]] | None
        ] = SimpleQueue()
        self._lock = Lock()
        self._waiting = 0
        self._thread: Thread | None = None

    def set(self, shadows: Mapping[LoadedModel, Sequence[LoadedModel]]) -> None:
        """Follow these versions from now on. Counters go on where a pair stays.

        Args:
            shadows: the shadows of each version, whose windows they take.
        """
        kept = {(each.model, each.comparison.of): each for many in self.shadowed.values() for each in many}
        self.shadowed = {
            model: [
                kept.get((shadow, model.label)) or _Shadow(shadow, Comparison(model.label))
                for shadow in several
            ]
            for model, several in shadows.items()
            if several
        }
        if self.shadowed and self._thread is None:
            self._thread = Thread(target=self._run, name="taxel-shadows", daemon=True)
            self._thread.start()

    def offer(
        self, model: LoadedModel, windows: NDArray[np.float32], answered: NDArray[np.float32]
    ) -> None:
        """Give a version's shadows a copy of answered windows (n, f) and their counts (n, 21 or more).

        Returns at once.
        """
        shadows = self.shadowed.get(model)
        if not shadows:
            return
        with self._lock:
            has_room = self._waiting + len(windows) <= _MOST_ROWS
            self._waiting += len(windows) if has_room else 0
        if has_room:
            self._queue.put((shadows, windows.copy(), answered[:, : len(CHANNELS)].copy()))
        else:
            for shadow in shadows:
                shadow.comparison.leave_out(len(windows), "skipped")

    def comparison(self, model: LoadedModel) -> dict[str, Any] | None:
        """What was counted for a shadow, as on the wire; None if the version is none."""
        for several in self.shadowed.values():
            for shadow in several:
                if shadow.model is model:
                    return shadow.comparison.as_dict()
        return None

    def close(self) -> None:
        """Compare no more."""
        self.shadowed = {}
        if self._thread is not None:
            self._queue.put(None)
            self._thread.join()

    def _run(self) -> None:
        if sys.platform == "linux":
            with suppress(OSError):
                os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), _NICE)
        # The loop has no variables: they would keep the last model while the thread waits.
        while self._step():
            pass

    def _step(self) -> bool:
        taken = self._queue.get()
        if taken is None:
            return False
        shadows, windows, answered = taken
        for shadow in shadows:
            try:
                shadow.comparison.add(answered, shadow.model.evaluate(windows)[:, : len(CHANNELS)])
            except Exception:
                _LOG.exception("%s: a shadow failed", shadow.model.label)
                shadow.comparison.leave_out(len(windows), "failed")
        with self._lock:
            self._waiting -= len(windows)
        return True
