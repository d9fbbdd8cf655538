"""The fingertips in a terminal, as over ssh: the map of the skin in colours, numbers, the last seconds."""

import time
from collections import deque
from contextlib import suppress
from functools import cache
from itertools import groupby
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from rich.color import Color
from rich.columns import Columns
from rich.console import Console, Group
from rich.live import Live
from rich.panel import Panel
from rich.style import Style
from rich.text import Text

from taxel.channels import CHANNELS, ELECTRODE_COLUMNS
from taxel.skin import Fingertip
from taxel_watch.colours import LIMIT, colours_of
from taxel_watch.scene import MEASURED, Finger, Player, Scene, TraceBlock
from taxel_watch.skin_map import electrodes_on_map, outline

RATE_HZ: Final = 8.0
"""Pictures a second: an ssh connection carries so many."""

_WIDTH: Final = 24
_HALF_ROWS: Final = 26
"""Of the map: a character shows two halves, one above the other."""

_BARS: Final = " ▁▂▃▄▅▆▇█"
_PAST: Final = 11
"""Pictures that the strips show."""


@cache
def electrode_at() -> NDArray[np.int64]:
    """(26, 24) the electrode nearest to each half of a character, from 0; -1 outside the skin."""
    tip = Fingertip.biotac_2p()
    edge, electrodes = outline(tip), electrodes_on_map(tip)
    low, high = edge.min(axis=0), edge.max(axis=0)
    across = low[0] + (np.arange(_WIDTH) + 0.5) / _WIDTH * (high[0] - low[0])
    along = high[1] - (np.arange(_HALF_ROWS) + 0.5) / _HALF_ROWS * (high[1] - low[1])
    places = np.stack(np.meshgrid(across, along), axis=-1)
    distances = np.linalg.norm(places[:, :, None] - electrodes, axis=-1)
    # The edge is symmetric, and no wider towards the tip: its right half says how far the skin reaches.
    right = edge[edge[:, 0] >= 0.0]
    right = right[np.argsort(right[:, 1])]
    reach = np.interp(along, right[:, 1], right[:, 0])
    return np.where(np.abs(across) <= reach[:, None], distances.argmin(axis=-1), -1)


def skin_text(less_rest: NDArray[np.float64]) -> Text:
    """The map, 13 lines of 24 characters, of the 19 electrodes' counts less rest; NaN has no colour."""
    known = np.isfinite(less_rest)
    rgb = colours_of(np.where(known, less_rest, 0.0), "dark")
    styles = [
        Color.from_rgb(*map(int, colour)) if is_known else None
        for colour, is_known in zip(rgb, known, strict=True)
    ]
    grid = electrode_at()
    text = Text()
    for row in range(0, _HALF_ROWS, 2):
        # Neighbours of one colour are written together: this takes less than half of the bytes.
        for (above, below), same in groupby(zip(grid[row], grid[row + 1], strict=True)):
            upper, lower = (styles[each] if each >= 0 else None for each in (above, below))
            width = len(list(same))
            if upper is None and lower is not None:
                text.append(width * "▄", Style(color=lower))
            else:
                text.append(width * ("▀" if upper is not None else " "), Style(color=upper, bgcolor=lower))
        text.append("\n")
    return text


def legend() -> Text:
    """The colours of a few counts less rest."""
    values = [-LIMIT, -LIMIT // 4, -LIMIT // 20, 0, LIMIT // 20, LIMIT // 4, LIMIT]
    text = Text("counts less rest  ")
    for value, colour in zip(values, colours_of(np.array(values, np.float64), "dark"), strict=True):
        text.append("██", Style(color=Color.from_rgb(*map(int, colour))))
        text.append(f" {value:+d}  " if value else " 0  ")
    return text


class Terminal:
    """Draws one player's scene.

    Args:
        player: what is drawn.
    """

    def __init__(self, player: Player) -> None:
        self._player = player
        self._scene: Scene | None = None
        self._newest: dict[str, TraceBlock] = {}
        self._past: dict[tuple[str, str], deque[float]] = {}

    def picture(self) -> Group:
        """The picture of this moment."""
        self._scene = self._player.scene() or self._scene
        update = self._player.update()
        if update is not None:
            self._newest.update(update.fingers)
        scene, status = self._scene, self._player.status()
        head = Text(f"{scene.title if scene else ''}   {_told(status)}")
        if scene is None:
            return Group(head)
        panels = [self._panel(finger, scene) for finger in scene.fingers if finger.key in self._newest]
        lines = [Text(status["note"], style="dim")] if status["note"] else []
        return Group(head, *lines, Columns(panels), legend())

    def _panel(self, finger: Finger, scene: Scene) -> Panel:
        block = self._newest[finger.key]
        less = block.counts[next(iter(scene.traces))][-1] - finger.rest
        text = skin_text(less[ELECTRODE_COLUMNS])
        force = float(np.linalg.norm(block.force[-1]))
        for name, told, value in (
            ("force", f"{force:.2f} N", force),
            ("pdc", f"{less[CHANNELS.index('pdc')]:+.0f}", less[CHANNELS.index("pdc")]),
            ("pac0", f"{less[CHANNELS.index('pac0')]:+.0f}", less[CHANNELS.index("pac0")]),
        ):
            past = self._past.setdefault((finger.key, name), deque(maxlen=_PAST))
            past.append(float(value))
            text.append(f"{name:<5}{told:>7} {strip(past)}\n")
        for trace in scene.traces:
            if trace != MEASURED and MEASURED in scene.traces:
                wrong = block.counts[MEASURED][-1] - block.counts[trace][-1]
                rms = np.sqrt(np.mean(wrong[ELECTRODE_COLUMNS] ** 2))
                text.append(f"{trace}: {rms:.0f} counts RMS\n", style="dim")
        text.rstrip()
        return Panel(text, title=f"{finger.hand} · {finger.label}", expand=False)


def strip(values: "deque[float]") -> str:
    """A line of bars, from the least to the largest of the values; flat where they differ by under 1."""
    known = np.nan_to_num(np.array(values))
    low, high = known.min(), known.max()
    places = np.rint((known - low) / max(high - low, 1.0) * (len(_BARS) - 1)).astype(int)
    return "".join(_BARS[place] for place in places)


def _told(status: dict[str, Any]) -> str:
    rate = "" if status["rate_hz"] is None else f"   {status['rate_hz']:.0f} Hz"
    times = status["latency_us"]
    latency = f"   p50 {times['p50']:.0f} µs, p99 {times['p99']:.0f} µs" if times else ""
    server = "".join(f"   {name} {value}" for name, value in status["server"].items())
    return f"{status['state']}{rate}{latency}{server}"


def draw(player: Player, console: Console, pictures: int | None = None) -> None:
    """Draw again and again, until Ctrl-C, or so many pictures."""
    terminal = Terminal(player)
    drawn = 0
    screen = Live(console=console, auto_refresh=False, screen=console.is_terminal)
    with suppress(KeyboardInterrupt), screen as live:
        while pictures is None or drawn < pictures:
            live.update(terminal.picture(), refresh=True)
            drawn += 1
            time.sleep(1.0 / RATE_HZ)
