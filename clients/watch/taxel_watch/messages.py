"""What the page is told, as JSON; docs/watch.md describes the messages."""

import json
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from taxel.channels import CHANNELS
from taxel.skin import PAD, Fingertip
from taxel_watch.colours import LIMIT, STOPS
from taxel_watch.scene import HISTORY_S, Scene, TraceBlock, Update
from taxel_watch.skin_map import electrodes_on_map, force_on_map, on_map, outline

VERSION: Final = 1

PASCALS_A_COUNT: Final = {"pdc": 36.5, "pac0": 0.37}
"""Of the pressure channels (BioTac SP manual V2, 2015)."""


def scene_message(scene: Scene) -> dict[str, Any]:
    """A scene, with the map of the skin."""
    tip = Fingertip.biotac_2p()
    return {
        "type": "scene",
        "version": VERSION,
        "kind": scene.kind,
        "title": scene.title,
        "duration_s": scene.duration_s,
        "overview_n": _rounded(scene.overview, 2),
        "history_s": HISTORY_S,
        "channels": list(CHANNELS),
        "pascals_a_count": PASCALS_A_COUNT,
        "limit": LIMIT,
        "colours": STOPS,
        "skin": {
            "outline_mm": _rounded(outline(tip), 3),
            "electrodes_mm": _rounded(electrodes_on_map(tip), 3),
            "pad_mm": _rounded(on_map(np.array([PAD]), tip)[0], 3),
        },
        "traces": dict(scene.traces),
        "fingers": [
            {"key": each.key, "label": each.label, "hand": each.hand, "rest": _rounded(each.rest, 2)}
            for each in scene.fingers
        ],
    }


def update_message(update: Update, number: int) -> dict[str, Any]:
    """An update; its number is what the page answers once it is drawn."""
    return {
        "type": "frame",
        "number": number,
        "at_s": round(update.at_s, 3),
        "restarts": update.restarts,
        "fingers": {key: _block(block) for key, block in update.fingers.items()},
    }


def _block(block: TraceBlock) -> dict[str, Any]:
    tip = Fingertip.biotac_2p()
    last = slice(len(block.time_s) - 1, None)
    return {
        "time_s": _rounded(block.time_s, 3),
        "force_n": _rounded(block.force, 4),
        "place_mm": _rounded(on_map(block.position[last], tip)[0], 3),
        "push_n": _rounded(force_on_map(block.position[last], block.force[last], tip)[0], 4),
        "counts": {trace: _rounded(counts, 1) for trace, counts in block.counts.items()},
    }


def encoded(message: dict[str, Any]) -> str:
    """One message as text."""
    return json.dumps(message, separators=(",", ":"), allow_nan=False)


def _rounded(values: NDArray[np.float64], digits: int) -> list[Any]:
    """Nested lists; None in place of NaN, which JSON lacks."""
    rounded: NDArray[Any] = np.round(values, digits)
    if not np.isfinite(rounded).all():
        rounded = rounded.astype(object)
        rounded[~np.isfinite(values)] = None
    return list(rounded.tolist())
