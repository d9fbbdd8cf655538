"""The demo's source: fingertips of the twin, warmed up, that are touched for a minute."""

from dataclasses import replace
from typing import Final

from taxel_models.twin import simulate
from taxel_models.twin.constants import Constants
from taxel_watch.replay import Replay

_ROWS: Final = 6000
_ON_FOR_S: Final = 1800.0
"""A cold finger differs from most of what the shipped models have seen."""

_FINGERS: Final = ("thumb", "index", "middle")
_SEED: Final = 2024
"""Of the first finger; the shipped models were trained on other seeds."""


def demo() -> Replay:
    """Three fingertips of one hand, each touched in its own way, again and again."""
    finger = replace(Constants(), on_for_s=_ON_FOR_S)
    return Replay(
        [simulate(_ROWS, _SEED + number, finger) for number in range(len(_FINGERS))],
        kind="twin",
        title="the twin, a simulated fingertip",
        names=[("demo hand", name) for name in _FINGERS],
        loops=True,
    )
