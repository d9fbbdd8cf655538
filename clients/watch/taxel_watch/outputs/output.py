"""What other tools are given, and when."""

import time
from collections.abc import Iterable, Iterator
from contextlib import suppress
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from taxel.channels import ELECTRODE_COLUMNS
from taxel.skin import Fingertip
from taxel_watch.colours import colours_of
from taxel_watch.replay import PERIOD_S, Replay
from taxel_watch.scene import MEASURED, PREDICTED, RATE_HZ, Finger, Player, Scene, TraceBlock, Update

RADIUS_M: Final = 0.001
"""Of the spheres that electrodes are drawn as, m."""

METRES_A_NEWTON: Final = 0.004
"""The length of a force's arrow."""

_CHUNK: Final = 1000


class Output(Protocol):
    """Takes scenes and updates until it is closed."""

    def write(self, scene: Scene, update: Update) -> None:
        """Take the next update of a scene."""

    def close(self) -> None:
        """Write what is left."""


def electrodes_m() -> NDArray[np.float64]:
    """The places on the skin nearest to e1 to e19, (19, 3) m, in the sensor's update."""
    tip = Fingertip.biotac_2p()
    return tip.nearest(tip.electrodes)


def electrode_colours(finger: Finger, block: TraceBlock) -> NDArray[np.int64]:
    """(n, 19, 3) the electrodes' colours: of the measured counts, or else of the predicted ones."""
    counts = block.counts.get(MEASURED, block.counts.get(PREDICTED))
    assert counts is not None
    less = np.nan_to_num(counts - finger.rest)[:, ELECTRODE_COLUMNS]
    return colours_of(less.ravel(), "light").reshape(*less.shape, 3)


def write_all(scene: Scene, updates: Iterable[Update], output: Output) -> None:
    """Write updates as fast as they come."""
    for update in updates:
        output.write(scene, update)


def of_whole(replay: Replay) -> Iterator[Update]:
    """All samples of a replay, ten seconds an update."""
    for start in range(0, replay.rows, _CHUNK):
        last = min(start + _CHUNK, replay.rows) - 1
        yield Update(last * PERIOD_S, replay.blocks(last, last + 1 - start))


def write_as_it_comes(player: Player, output: Output, seconds: float | None = None) -> None:
    """Write a player's updates at its own pace, until Ctrl-C or for so long."""
    scene: Scene | None = None
    ends = None if seconds is None else time.monotonic() + seconds
    with suppress(KeyboardInterrupt):
        while ends is None or time.monotonic() < ends:
            scene = player.scene() or scene
            if scene is not None and (update := player.update()) is not None:
                output.write(scene, update)
            time.sleep(1.0 / RATE_HZ)
