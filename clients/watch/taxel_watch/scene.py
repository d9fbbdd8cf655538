"""What is shown: a scene, which stays, and frames, which follow each other.

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
"""Frames a second."""

HISTORY_S: Final = 10.0
"""How much of the past the strip charts show, s."""


@dataclass(frozen=True)
class Finger:
    """A fingertip of a scene.

    Attributes:
        key: its name in frames.
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
    """What stays while frames come.

    Attributes:
        kind: where the data come from.
        title: the name of the source.
        fingers: every fingertip there is now.
        traces: the names of the counts in frames (`measured`, `predicted`, `corrected`), and the model of
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
class Moments:
    """Consecutive moments of one fingertip; the last is the one that is shown.

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
class Frame:
    """What is new.

    Attributes:
        at_s: the moment that is shown, on the scene's clock, s.
        fingers: by key, those with new moments since the last frame.
        restarts: whether the moments replace the past instead of following it.
    """

    at_s: float
    fingers: Mapping[str, Moments]
    restarts: bool = False


class Player(Protocol):
    """One viewer's way through a source. All its calls return at once."""

    def scene(self) -> Scene | None:
        """The scene, if it has changed since the last call."""

    def frame(self) -> Frame | None:
        """What is new since the last call; None if nothing is."""

    def status(self) -> dict[str, Any]:
        """State, rate, latency and server, as docs/watch.md describes them."""

    def command(self, name: str, value: float) -> None:
        """Do what a viewer asks for, such as `seek`; what a source cannot do is ignored."""


class Source(Protocol):
    """Where scenes and frames come from."""

    def player(self) -> Player:
        """For one more viewer, from the start of a recording, or from now on."""

    def close(self) -> None:
        """Release what the source holds."""
