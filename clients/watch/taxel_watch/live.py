"""The traffic of a running server as a source: what its clients ask, and what they get."""

import time
from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from threading import Event, Thread
from typing import Any, Final

import numpy as np

from taxel.channels import CHANNELS
from taxel.commands.top import compared, read_statistics
from taxel.errors import RequestError
from taxel.protocol import unpackb
from taxel.remote import RemoteSource
from taxel_watch.scene import PREDICTED, RATE_HZ, Finger, Scene, TraceBlock, Update

_STATISTICS_S: Final = 1.0
_TIMES: Final = 300
"""Newest requests at the last looks, over which latencies are told."""

_TOTALS: Final = round(2.0 * RATE_HZ)
"""Looks over which the rate is told."""

_SILENT_S: Final = 10.0
"""A client that asks nothing for so long is no longer shown."""

_SAME_S: Final = 0.01

_NOBODY: Final = "no client asks this server; the page moves as soon as one does"


@dataclass(frozen=True)
class Heard:
    """What is known of the server now; a new one replaces it.

    Attributes:
        scene: every fingertip that was heard of lately.
        blocks: the newest of each, by key.
        number: rises with each look at the server that brought something.
        state: `live`, `waiting` for clients, or `no answer`.
        rate_hz: requests in a second; None before two looks.
        latency_us: over the last looks: `p50`, `p99`.
        server: figures of the server, by name.
        note: what a viewer should know.
    """

    scene: Scene
    blocks: Mapping[str, TraceBlock] = field(default_factory=dict)
    number: int = 0
    state: str = "waiting"
    rate_hz: float | None = None
    latency_us: Mapping[str, float] = field(default_factory=dict)
    server: Mapping[str, str] = field(default_factory=dict)
    note: str = _NOBODY


class Live:
    """Looks at a server 30 times in a second, from construction until `close`. Thread-safe.

    Args:
        server: the connection, which this does not close.

    Raises:
        PermissionDenied: the server may not be watched.
        RequestError: it does not answer.
    """

    def __init__(self, server: RemoteSource) -> None:
        self._server = server
        self._began = time.monotonic()
        self._times: deque[int] = deque(maxlen=_TIMES)
        self._totals: deque[tuple[float, int]] = deque(maxlen=_TOTALS)
        self.heard = Heard(Scene("live", server.endpoint, (), {PREDICTED: ""}))
        self._take(self._look())
        self._stop = Event()
        self._thread = Thread(target=self._run, name="taxel-watch", daemon=True)
        self._thread.start()

    @property
    def now_s(self) -> float:
        """This moment on the scene's clock, s."""
        return time.monotonic() - self._began

    def player(self) -> "LivePlayer":
        """For one more viewer, from now on."""
        return LivePlayer(self)

    def close(self) -> None:
        """Look no more."""
        self._stop.set()
        self._thread.join()

    def _run(self) -> None:
        statistics_at, before = 0.0, None
        while not self._stop.wait(1.0 / RATE_HZ):
            try:
                self._take(self._look())
                if (now := time.monotonic()) - statistics_at >= _STATISTICS_S:
                    read = read_statistics(self._server)
                    if before is not None:
                        self._describe(compared(before, read, now - statistics_at))
                    statistics_at, before = now, read
            except RequestError as error:
                self._change(state="no answer", note=f"{error}; trying again …")
                self._stop.wait(0.5)

    def _look(self) -> dict[str, Any]:
        told: dict[str, Any] = unpackb(self._server.get(f"{self._server.prefix}/v2/watch"))
        return told

    def _take(self, told: Mapping[str, Any]) -> None:
        """Keep the newest of every client that has asked lately."""
        now = time.monotonic()
        fingers: list[Finger] = []
        blocks: dict[str, TraceBlock] = {}
        for client in told["clients"]:
            if client.get("age_s", _SILENT_S) < _SILENT_S:
                for finger, block in _fingers_of(client, now - client["age_s"] - self._began):
                    fingers.append(finger)
                    blocks[finger.key] = block
                self._times.append(client["queue_us"] + client["compute_us"])
        scene = self.heard.scene
        if [finger.key for finger in fingers] != [finger.key for finger in scene.fingers]:
            models = {f"{client['model']}/{client['version']}" for client in told["clients"]}
            scene = replace(scene, fingers=tuple(fingers), traces={PREDICTED: ", ".join(sorted(models))})
        self._totals.append((now, sum(client["requests"] for client in told["clients"])))
        self._change(
            scene=scene,
            blocks=blocks,
            number=self.heard.number + 1,
            state="live" if fingers else "waiting",
            rate_hz=_rate(self._totals),
            latency_us=_percentiles(self._times),
            note="" if fingers else _NOBODY,
        )

    def _describe(self, told: Mapping[str, Any]) -> None:
        """Keep figures of the server over the last second."""
        connections = ", ".join(f"{count} {name}" for name, count in told["connections"].items())
        self._change(
            server={
                "up": f"{told['uptime_s']:,.0f} s",
                "clients": connections or "none",
                "queue": f"{told['queue']['rows']} windows",
                "memory": f"{told['resident_bytes'] / 2**20:,.0f} MiB",
            }
        )

    def _change(self, **changes: Any) -> None:
        self.heard = replace(self.heard, **changes)


def _fingers_of(client: Mapping[str, Any], time_s: float) -> Iterator[tuple[Finger, TraceBlock]]:
    """The fingertips of a client's newest request: each of its windows is one."""
    place = f"{client['client']} · {client['model']}/{client['version']}"
    contacts = np.frombuffer(client["contacts"], "<f4").reshape(-1, 6).astype(np.float64)
    counts = np.frombuffer(client["counts"], "<f4").reshape(-1, len(CHANNELS)).astype(np.float64)
    for number in range(len(counts)):
        row = slice(number, number + 1)
        finger = Finger(f"{place} {number}", f"finger {number + 1}", place, np.array(client["rest"]))
        block = TraceBlock(
            np.array([time_s]), contacts[row, :3], contacts[row, 3:], {PREDICTED: counts[row]}
        )
        yield finger, block


def _rate(totals: "deque[tuple[float, int]]") -> float | None:
    """Requests in a second, from totals at moments."""
    (first_at, first), (last_at, last) = totals[0], totals[-1]
    return max(last - first, 0) / (last_at - first_at) if last_at > first_at else None


def _percentiles(times_us: "deque[int]") -> dict[str, float]:
    if not times_us:
        return {}
    return {"p50": float(np.median(times_us)), "p99": float(np.quantile(times_us, 0.99))}


class LivePlayer:
    """One viewer of a server's traffic."""

    def __init__(self, live: Live) -> None:
        self._live = live
        self._scene: Scene | None = None
        self._given: dict[str, float] = {}
        """The time of the last moment that was given, by fingertip."""

    def scene(self) -> Scene | None:
        """The scene, if clients have come or gone."""
        scene = self._live.heard.scene
        if scene is self._scene:
            return None
        self._scene = scene
        return scene

    def update(self) -> Update | None:
        """The newest moment of each fingertip that has a new one."""
        fresh = {}
        for key, block in self._live.heard.blocks.items():
            # A request is noted every 25 ms at most; a smaller difference is one of clocks.
            if block.time_s[-1] > self._given.get(key, -1.0) + _SAME_S:
                self._given[key] = block.time_s[-1]
                fresh[key] = block
        return Update(self._live.now_s, fresh) if fresh else None

    def status(self) -> dict[str, Any]:
        """State, rate, latency and figures of the server."""
        heard = self._live.heard
        return {
            "state": heard.state,
            "speed": 1.0,
            "rate_hz": heard.rate_hz,
            "latency_us": dict(heard.latency_us),
            "latency_of": "a request in the server: queue and evaluation",
            "server": dict(heard.server),
            "note": heard.note,
        }

    def command(self, name: str, value: float) -> None:
        """What is live can be neither paused nor sought."""
