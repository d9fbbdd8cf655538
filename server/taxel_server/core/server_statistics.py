"""What the whole server has done since it started: put together when somebody asks, never per request."""

import time
from collections.abc import Callable, Mapping
from typing import Any

from taxel_server.core.batcher import Batcher
from taxel_server.core.refusals import Refusals
from taxel_server.engine import Engine, LoadedModel
from taxel_server.processor import resident_bytes


class ServerStatistics:
    """Reads the counters of the batcher, its models, the transports and the loader.

    Args:
        engine: whose models these are.
        batcher: counts requests, rows and times.
        refusals: counts errors.

    Attributes:
        connections: how many clients each transport has; a transport adds itself when it listens.
        loads: versions that were loaded or refused, counted by the loader.
    """

    def __init__(self, engine: Engine, batcher: Batcher, refusals: Refusals) -> None:
        self._engine = engine
        self._batcher = batcher
        self._refusals = refusals
        self._started = time.monotonic()
        self.connections: dict[str, Callable[[], int]] = {}
        self.loads: Mapping[str, int] = {}

    def of_model(self, model: LoadedModel) -> dict[str, Any]:
        """The statistics of one version, and how it differs if it is a shadow."""
        compared = self._batcher.shadows.comparison(model)
        told = self._batcher.statistics(model)
        return told if compared is None else {**told, "shadow": compared}

    def read(self) -> dict[str, Any]:
        """Everything, as on the wire at `v2/stats`."""
        return {
            "uptime_s": time.monotonic() - self._started,
            "queue": {"rows": self._batcher.queued_rows, "requests": self._batcher.open_requests},
            "connections": {name: count() for name, count in self.connections.items()},
            "refusals": [list(each) for each in self._refusals.counts()],
            "loads": dict(self.loads),
            "resident_bytes": resident_bytes(),
            "run_delay_s": self._batcher.run_delay(),
            "models": [
                {
                    "name": model.manifest.name,
                    "version": model.manifest.version,
                    **self.of_model(model),
                }
                for model in self._engine.loaded()
            ],
        }
