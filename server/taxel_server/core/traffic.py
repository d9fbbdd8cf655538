"""Traffic for whoever watches: what each client asked last, and what it got.

The core's requests are followed only while somebody looks: after a look, for `_LOOK_S`. Of each client, an
answer is kept every 25 ms at most, and the others are only counted.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass
from threading import Lock
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from taxel.channels import CHANNELS
from taxel.errors import Cancelled, RequestError
from taxel.protocol import InferResponse
from taxel.skin import PAD
from taxel_server.core.jobs import Job
from taxel_server.engine import LoadedModel

_LOOK_S: Final = 2.0
"""How long requests are followed after a look."""

_NOTE_S: Final = 0.025
"""The shortest time between two notes of a client: viewers draw 30 frames in a second."""

_MOST_ROWS: Final = 32
"""Windows of a request that are shown: the first ones."""

_MOST_CLIENTS: Final = 64

_CONTACT: Final = ("x", "y", "z", "fx", "fy", "fz")
"""The features of a window that say where the finger is touched at T, and with what force."""


@dataclass
class _Noted:
    """A client's requests for a model since it was first seen, and the newest of them."""

    requests: int = 0
    rows: int = 0
    errors: int = 0
    at: float = 0.0
    windows: NDArray[np.float32] | None = None
    counts: NDArray[np.float32] | None = None
    queue_us: int = 0
    compute_us: int = 0


class Traffic:
    """Notes what clients ask while somebody looks. Thread-safe.

    Args:
        follow: begins to tell the requests to `see` and `note` (True), or ends it (False).
    """

    def __init__(self, follow: Callable[[bool], None]) -> None:
        self._follow = follow
        self._lock = Lock()
        self._follows = False
        self._until = 0.0
        self._clients: dict[tuple[str, LoadedModel], _Noted] = {}
        self._rest: dict[LoadedModel, list[float]] = {}

    def look(self) -> dict[str, Any]:
        """What every client asked last; requests are followed from now on, for a while.

        Returns:
            As on the wire at `v2/watch`.
        """
        now = time.monotonic()
        with self._lock:
            self._until = now + _LOOK_S
            if not self._follows:
                self._follows = True
                self._clients.clear()
                self._follow(True)
            seen = [(name, model, noted) for (name, model), noted in self._clients.items()]
        return {"clients": [self._told(name, model, noted, now) for name, model, noted in seen]}

    def see(self, job: Job, result: InferResponse | RequestError) -> None:
        """Note a job that has its answer; not one that its client has given up."""
        if isinstance(result, Cancelled):
            return
        # All clients of zenoh have one name in logs; here, each has its session's.
        name = f"{job.caller} {job.client[:8]}" if isinstance(job.client, str) else job.caller
        noted = self._due(name or "this process", job.model)
        if isinstance(result, RequestError):
            if noted is not None:
                noted.errors += 1
        elif noted is not None and self._count(noted, len(result.outputs)):
            _keep(noted, job.decode().windows, result.outputs, result.queue_us, result.compute_us)

    def note(
        self,
        client: str,
        model: LoadedModel,
        windows: NDArray[np.float32],
        counts: NDArray[np.float32],
        compute_us: int,
    ) -> None:
        """Note a request that was evaluated at once. Its windows are copied."""
        noted = self._due(client, model)
        if noted is not None and self._count(noted, len(counts)):
            _keep(noted, windows, counts, 0, compute_us)

    def _due(self, client: str, model: LoadedModel) -> _Noted | None:
        """Where to note a request; None if nobody looks any more, or there are too many clients."""
        with self._lock:
            if time.monotonic() > self._until:
                self._follows = False
                self._follow(False)
                return None
            noted = self._clients.get((client, model))
            if noted is None and len(self._clients) < _MOST_CLIENTS:
                noted = self._clients[client, model] = _Noted()
            return noted

    @staticmethod
    def _count(noted: _Noted, rows: int) -> bool:
        """Count a request; returns whether it is to be kept."""
        noted.requests += 1
        noted.rows += rows
        return time.monotonic() - noted.at >= _NOTE_S

    def _told(self, name: str, model: LoadedModel, noted: _Noted, now: float) -> dict[str, Any]:
        windows, counts = noted.windows, noted.counts
        told: dict[str, Any] = {
            "client": name,
            "model": model.manifest.name,
            "version": model.manifest.version,
            "requests": noted.requests,
            "rows": noted.rows,
            "errors": noted.errors,
        }
        if windows is None or counts is None:
            return told
        features = model.manifest.window.features
        contact = windows[:, [features.index(name) for name in _CONTACT]]
        return {
            **told,
            "age_s": now - noted.at,
            "queue_us": noted.queue_us,
            "compute_us": noted.compute_us,
            "fingers": len(counts),
            "contacts": np.ascontiguousarray(contact, "<f4").tobytes(),
            "counts": np.ascontiguousarray(counts, "<f4").tobytes(),
            "rest": self._resting(model),
        }

    def _resting(self, model: LoadedModel) -> list[float]:
        """What a model predicts for a finger that nothing has touched for long."""
        if model not in self._rest:
            layout = model.manifest.window
            pad = dict(zip(_CONTACT[:3], PAD, strict=True))
            given = pad | {extra.name: extra.default for extra in layout.extras}
            # The places of neighbouring ticks are called x[-10], and so on.
            window = [given.get(name, pad.get(name.partition("[")[0], 0.0)) for name in layout.features]
            counts = model.evaluate(np.array([window], np.float32))
            self._rest[model] = counts[0, : len(CHANNELS)].astype(float).tolist()
        return self._rest[model]


def _keep(
    noted: _Noted,
    windows: NDArray[np.float32],
    counts: NDArray[np.float32],
    queue_us: int,
    compute_us: int,
) -> None:
    noted.windows, noted.counts = windows[:_MOST_ROWS].copy(), counts[:_MOST_ROWS].copy()
    noted.queue_us, noted.compute_us, noted.at = queue_us, compute_us, time.monotonic()
