"""What is shown: a scene, which stays, and updates, which follow each other.

A source of data makes both; the page, the terminal and other viewers show them.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

MEASURED: Final = "measured"
PREDICTED: Final = "predicted"
CORRECTED: Final = "corrected"

RATE_HZ: Final = 30.0
"""Updates a second."""

HISTORY_S: Final = 10.0
"""How much of the past the strip charts show, s."""


@dataclass(frozen=True)
class Finger:
    """A fingertip of a scene.

    Attributes:
        key: its name in updates.
        label: its name on the screen.
        hand: what it belongs to: fingertips of one hand stand together.
        rest: (21,) resting counts, which what is shown is less.
    """

    key: str
    label: str
    hand: str
    rest: NDArray[np.float64]


@dataclass(frozen=True)
class Scene:
    """What stays while updates come.

    Attributes:
        kind: where the data come from.
        title: the name of the source.
        fingers: every fingertip there is now.
        traces: the names of the counts in updates (`measured`, `predicted`, `corrected`), and the model of
            each; empty where it is the sensor itself.
        duration_s: how long the recording is; None of a live source.
        overview: (n,) the largest force in each of n equal parts of a recording, N.
    """

    kind: Literal["live", "recording", "twin"]
    title: str
    fingers: tuple[Finger, ...]
    traces: Mapping[str, str]
    duration_s: float | None = None
    overview: NDArray[np.float64] = field(default_factory=lambda: np.empty(0))


@dataclass(frozen=True)
class TraceBlock:
    """Consecutive samples of one fingertip, and the counts of each trace there; the last one is shown.

    Attributes:
        time_s: (n,), on the scene's clock, s.
        position: (n, 3), in the sensor's frame, m.
        force: (n, 3), on the finger, N.
        counts: by trace, each (n, 21), counts; NaN where a model gives none.
    """

    time_s: NDArray[np.float64]
    position: NDArray[np.float64]
    force: NDArray[np.float64]
    counts: Mapping[str, NDArray[np.float64]]


@dataclass(frozen=True)
class Update:
    """What is new; the page gets it as a message of type `frame`.

    Attributes:
        at_s: the moment that is shown, on the scene's clock, s.
        fingers: by key, those with new samples since the last update.
        restarts: whether the samples replace the past instead of following it.
    """

    at_s: float
    fingers: Mapping[str, TraceBlock]
    restarts: bool = False


class Player(Protocol):
    """One viewer's way through a source. All its calls return at once."""

    def scene(self) -> Scene | None:
        """The scene, if it has changed since the last call."""

    def update(self) -> Update | None:
        """What is new since the last call; None if nothing is."""

    def status(self) -> dict[str, Any]:
        """State, rate, latency and server, as docs/watch.md describes them."""

    def command(self, name: str, value: float) -> None:
        """Do what a viewer asks for, such as `seek`; what a source cannot do is ignored."""


class Source(Protocol):
    """Where scenes and updates come from."""

    def player(self) -> Player:
        """For one more viewer, from the start of a recording, or from now on."""

    def close(self) -> None:
        """Release what the source holds."""
