"""Rerun: a file, or its viewer at once."""

from pathlib import Path
from typing import Final

import numpy as np
import rerun as rr

from taxel.channels import CHANNELS, ELECTRODES
from taxel.errors import SettingsError
from taxel_watch.outputs.output import METRES_A_NEWTON, RADIUS_M, electrode_colours, electrodes_m
from taxel_watch.scene import Finger, Scene, TraceBlock, Update

TIMELINE: Final = "time"
"""Seconds since the start."""


class RerunOutput:
    """Entities `HAND/FINGER/…`: `electrodes` and `force` in 3D; `force_n`, `measured` … over time.

    Args:
        stream: where they go.
    """

    def __init__(self, stream: rr.RecordingStream) -> None:
        self._stream = stream
        self._known: set[str] = set()

    def write(self, scene: Scene, update: Update) -> None:
        """Take the next update of a scene."""
        for finger in scene.fingers:
            if (block := update.fingers.get(finger.key)) is not None:
                self._write(finger, block)

    def close(self) -> None:
        """Write what is left."""
        self._stream.flush()
        self._stream.disconnect()

    def _write(self, finger: Finger, block: TraceBlock) -> None:
        rows = len(block.time_s)

        def entity(name: str) -> str:
            return rr.new_entity_path([finger.hand, finger.label, name])

        if finger.key not in self._known:
            self._known.add(finger.key)
            points = rr.Points3D(electrodes_m(), radii=RADIUS_M, labels=list(ELECTRODES), show_labels=False)
            self._stream.log(entity("electrodes"), points, static=True)
            self._stream.log(entity("force_n"), rr.SeriesLines(names=["x", "y", "z"]), static=True)
            for trace in block.counts:
                self._stream.log(entity(trace), rr.SeriesLines(names=list(CHANNELS)), static=True)
        colours = electrode_colours(finger, block).reshape(-1, 3).astype(np.uint8)
        columns = {
            "force_n": rr.Scalars.columns(scalars=block.force),
            **{trace: rr.Scalars.columns(scalars=counts) for trace, counts in block.counts.items()},
            "electrodes": rr.Points3D.columns(colors=colours).partition([len(ELECTRODES)] * rows),
            "force": rr.Arrows3D.columns(
                origins=block.position,
                vectors=METRES_A_NEWTON * block.force,
                radii=[RADIUS_M / 4] * rows,
            ),
        }
        when = [rr.TimeColumn(TIMELINE, duration=block.time_s)]
        for name, values in columns.items():
            rr.send_columns(entity(name), indexes=when, columns=values, recording=self._stream)


def rerun_file(path: Path) -> RerunOutput:
    """An output to a new `.rrd` file.

    Raises:
        SettingsError: there is such a file.
        OSError: it cannot be written.
    """
    if path.exists():
        raise SettingsError(f"{path}: exists; expected the name of a new file, or `spawn`")
    stream = rr.RecordingStream("taxel")
    stream.save(path)
    return RerunOutput(stream)


def rerun_viewer() -> RerunOutput:
    """An output to Rerun's viewer, which is started."""
    stream = rr.RecordingStream("taxel")
    stream.spawn()
    return RerunOutput(stream)
