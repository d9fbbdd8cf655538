"""Recordings as a source: played, paused, sought; predictions join them when they are there."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from threading import Lock
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from taxel.windows import PERIOD_NS
from taxel_models.loop.resting import resting
from taxel_models.recordings import Recording
from taxel_watch.scene import HISTORY_S, MEASURED, Finger, Scene, TraceBlock, Update

PERIOD_S: Final = PERIOD_NS / 1e9
_OVERVIEW: Final = 400
_SPEEDS: Final = (0.05, 8.0)
_HISTORY_ROWS: Final = round(HISTORY_S / PERIOD_S)
_HISTORY_STEP: Final = 3
"""Of the past that a viewer gets at once, every third row: a strip chart has no more pixels."""


@dataclass
class Predictions:
    """What is known of the predictions so far.

    Attributes:
        models: the label of each trace's model.
        counts: for each finger, (n, 21) counts by trace.
        note: what a viewer should know while there are none.
        window_us: how long the prediction of a single window takes, µs: `p50`, `p99`.
        where: what predicts.
    """

    models: Mapping[str, str] = field(default_factory=dict)
    counts: Sequence[Mapping[str, NDArray[np.float64]]] = ()
    note: str = ""
    window_us: Mapping[str, float] = field(default_factory=dict)
    where: str = ""


class Replay:
    """Recordings that play side by side, one a fingertip. The clock leaves their gaps out. Thread-safe.

    Args:
        recordings: at 10 ms ticks, not empty.
        kind: what to call them.
        title: of the scene.
        names: the hand of each fingertip, and its label.
        loops: whether the end is followed by the start.
        clock: seconds, never backwards.
    """

    def __init__(
        self,
        recordings: Sequence[Recording],
        *,
        kind: Literal["recording", "twin"],
        title: str,
        names: Sequence[tuple[str, str]],
        loops: bool = False,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.recordings = tuple(recordings)
        self.loops = loops
        self.clock = clock
        self.rows = max(map(len, recordings))
        self.version = 0
        self.predictions = Predictions()
        self._lock = Lock()
        self._kind: Literal["recording", "twin"] = kind
        self._title = title
        forces = [np.linalg.norm(recording.samples.force, axis=1) for recording in recordings]
        self._fingers = tuple(
            Finger(str(number), label, hand, resting(force, recording.channels))
            for number, (recording, force, (hand, label)) in enumerate(
                zip(recordings, forces, names, strict=True)
            )
        )
        self._overview = _largest(forces, self.rows)

    def predicted(self, predictions: Predictions) -> None:
        """Add predictions, or say what became of them."""
        with self._lock:
            self.predictions = predictions
            self.version += 1

    def scene(self) -> Scene:
        """The scene as it is now."""
        return Scene(
            self._kind,
            self._title,
            self._fingers,
            {MEASURED: "", **self.predictions.models},
            duration_s=self.rows * PERIOD_S,
            overview=self._overview,
        )

    def blocks(self, last: int, count: int, step: int = 1) -> dict[str, TraceBlock]:
        """Every `step`th of `count` rows up to `last`, by key, of fingertips whose recordings have them."""
        found = {}
        for number, recording in enumerate(self.recordings):
            rows = np.arange(last, max(last - count, -1), -step)[::-1]
            rows = rows[rows < len(recording)]
            if len(rows):
                counts = {MEASURED: recording.channels[rows]}
                if self.predictions.counts:
                    counts |= {name: each[rows] for name, each in self.predictions.counts[number].items()}
                found[str(number)] = TraceBlock(
                    (rows * PERIOD_S).astype(np.float64),
                    recording.samples.position[rows],
                    recording.samples.force[rows],
                    counts,
                )
        return found

    def player(self) -> "ReplayPlayer":
        """For one more viewer, from the start."""
        return ReplayPlayer(self)

    def close(self) -> None:
        """Nothing is held."""


class ReplayPlayer:
    """One viewer's place in a replay."""

    def __init__(self, replay: Replay) -> None:
        self._replay = replay
        self._speed = 1.0
        self._playing = True
        self._began = replay.clock()
        self._from_row = 0.0
        self._shown: int | None = None
        """The last row that was given; None where the past is to be given again."""
        self._version = -1

    def scene(self) -> Scene | None:
        """The scene, if it has changed: predictions have come."""
        if self._version == self._replay.version:
            return None
        self._version = self._replay.version
        self._shown = None
        return self._replay.scene()

    def update(self) -> Update | None:
        """The rows since the last update, at most the strip charts' past."""
        row = self._row()
        if row == self._shown:
            return None
        shown, self._shown = self._shown, row
        if shown is None or not 0 < row - shown <= _HISTORY_ROWS // _HISTORY_STEP:
            past = self._replay.blocks(row, _HISTORY_ROWS, _HISTORY_STEP)
            return Update(row * PERIOD_S, past, restarts=True)
        return Update(row * PERIOD_S, self._replay.blocks(row, row - shown))

    def status(self) -> dict[str, Any]:
        """State, rate and what predicts."""
        predictions = self._replay.predictions
        self._row()
        return {
            "state": "playing" if self._playing else "paused",
            "speed": self._speed,
            "rate_hz": 1.0 / PERIOD_S,
            "latency_us": dict(predictions.window_us),
            "latency_of": "prediction of one window" if predictions.window_us else "",
            "server": {"predicted": predictions.where} if predictions.where else {},
            "note": predictions.note,
        }

    def command(self, name: str, value: float) -> None:
        """`play`, `pause`, `seek` (s), `step` (rows), `speed` (times real time)."""
        row = self._row()
        if name == "play":
            at_end = row >= self._replay.rows - 1
            self._go_on_from(0.0 if at_end else row, playing=True)
        elif name == "pause":
            self._go_on_from(row, playing=False)
        elif name == "seek":
            self._go_on_from(value / PERIOD_S, playing=self._playing)
        elif name == "step":
            self._go_on_from(row + value, playing=False)
        elif name == "speed":
            self._go_on_from(row, playing=self._playing)
            self._speed = min(max(value, _SPEEDS[0]), _SPEEDS[1])

    def _go_on_from(self, row: float, *, playing: bool) -> None:
        self._from_row = min(max(row, 0.0), self._replay.rows - 1.0)
        self._began, self._playing = self._replay.clock(), playing

    def _row(self) -> int:
        """The row of this moment."""
        if not self._playing:
            return round(self._from_row)
        row = self._from_row + self._speed * (self._replay.clock() - self._began) / PERIOD_S
        if row >= self._replay.rows and not self._replay.loops:
            self._go_on_from(self._replay.rows - 1.0, playing=False)
            return self._replay.rows - 1
        return int(row + 1e-6) % self._replay.rows


def _largest(forces: Sequence[NDArray[np.float64]], rows: int) -> NDArray[np.float64]:
    """(m,) the largest force of any fingertip in each of m equal parts."""
    largest = np.zeros(rows)
    for force in forces:
        np.maximum(largest[: len(force)], force, out=largest[: len(force)])
    starts = np.unique(np.linspace(0, rows, min(rows, _OVERVIEW), endpoint=False).astype(np.int64))
    return np.asarray(np.maximum.reduceat(largest, starts))
