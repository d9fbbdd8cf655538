"""Foxglove: an MCAP file, which many tools read, or a WebSocket that the Foxglove app connects to."""

from pathlib import Path
from typing import Any, Final

import foxglove
import numpy as np
from foxglove.channels import SceneUpdateChannel
from foxglove.messages import (
    ArrowPrimitive,
    Color,
    Pose,
    Quaternion,
    SceneEntity,
    SceneUpdate,
    SpherePrimitive,
    Timestamp,
    Vector3,
)
from numpy.typing import NDArray

from taxel.channels import CHANNELS
from taxel.errors import SettingsError
from taxel_watch.outputs.output import METRES_A_NEWTON, RADIUS_M, electrode_colours, electrodes_m
from taxel_watch.scene import Finger, Scene, TraceBlock, Update

_NUMBERS: Final = {"type": "number"}
_XYZ: Final = {"type": "object", "properties": dict.fromkeys("xyz", _NUMBERS)}
_COUNTS: Final = {"type": "object", "properties": dict.fromkeys(CHANNELS, _NUMBERS)}


class FoxgloveOutput:
    """Two topics a fingertip: `/HAND/FINGER/signals` as JSON at every moment, `…/skin` for the 3D panel.

    Args:
        context: what the topics belong to.
        sink: the file or the server that they go to; it is closed with this.
    """

    def __init__(self, context: foxglove.Context, sink: Any) -> None:
        self._context = context
        self._sink = sink
        self._signals: dict[str, foxglove.Channel] = {}
        self._skins: dict[str, SceneUpdateChannel] = {}

    def write(self, scene: Scene, update: Update) -> None:
        """Take the next update of a scene."""
        for finger in scene.fingers:
            if (block := update.fingers.get(finger.key)) is not None:
                self._write(finger, block, list(scene.traces))

    def close(self) -> None:
        """Write what is left, and end."""
        close = getattr(self._sink, "stop", None) or self._sink.close
        close()

    def _write(self, finger: Finger, block: TraceBlock, traces: list[str]) -> None:
        if finger.key not in self._signals:
            topic = f"/{finger.hand}/{finger.label}"
            schema = {
                "type": "object",
                "title": "taxel.Signals",
                "properties": {"position_m": _XYZ, "force_n": _XYZ, **dict.fromkeys(traces, _COUNTS)},
            }
            self._signals[finger.key] = foxglove.Channel(
                f"{topic}/signals", schema=schema, message_encoding="json", context=self._context
            )
            self._skins[finger.key] = SceneUpdateChannel(f"{topic}/skin", context=self._context)
        for row, moment in enumerate(block.time_s):
            message = {
                "position_m": dict(zip("xyz", block.position[row].tolist(), strict=True)),
                "force_n": dict(zip("xyz", block.force[row].tolist(), strict=True)),
                **{
                    trace: dict(zip(CHANNELS, counts[row].tolist(), strict=True))
                    for trace, counts in block.counts.items()
                    if np.isfinite(counts[row]).all()
                },
            }
            self._signals[finger.key].log(message, log_time=_ns(moment))
        # Every third moment, back from the last: a picture needs 30 in a second.
        colours = electrode_colours(finger, block)
        for row in range((len(block.time_s) - 1) % 3, len(block.time_s), 3):
            at = _ns(block.time_s[row])
            name = f"{finger.hand}/{finger.label}"
            entity = _skin(block.position[row], block.force[row], colours[row], at, name)
            self._skins[finger.key].log(SceneUpdate(entities=[entity]), log_time=at)


def mcap_file(path: Path) -> FoxgloveOutput:
    """An output to a new MCAP file.

    Raises:
        SettingsError: there is such a file.
        OSError: it cannot be written.
    """
    if path.exists():
        raise SettingsError(f"{path}: exists; expected the name of a new file")
    context = foxglove.Context()
    return FoxgloveOutput(context, foxglove.open_mcap(path, context=context))


def foxglove_server(host: str, port: int) -> tuple[FoxgloveOutput, str]:
    """An output to the Foxglove app, and the address to open there.

    Raises:
        SettingsError: it cannot be listened on.
    """
    context = foxglove.Context()
    try:
        server = foxglove.start_server(name="taxel", host=host, port=port, context=context)
    except Exception as error:
        raise SettingsError(f"cannot listen on {host}:{port}: {error}; expected a free port") from None
    return FoxgloveOutput(context, server), f"ws://{host}:{server.port}"


def _ns(seconds: float) -> int:
    return round(seconds * 1e9)


def _skin(
    position: NDArray[np.float64],
    force: NDArray[np.float64],
    colours: NDArray[np.int64],
    at_ns: int,
    frame_id: str,
) -> SceneEntity:
    spheres = [
        SpherePrimitive(
            pose=Pose(position=_vector(place), orientation=Quaternion(w=1.0)),
            size=Vector3(x=2 * RADIUS_M, y=2 * RADIUS_M, z=2 * RADIUS_M),
            color=Color(r=colour[0] / 255, g=colour[1] / 255, b=colour[2] / 255, a=1.0),
        )
        for place, colour in zip(electrodes_m(), colours.tolist(), strict=True)
    ]
    length = METRES_A_NEWTON * float(np.linalg.norm(force))
    arrow = ArrowPrimitive(
        pose=Pose(position=_vector(position), orientation=Quaternion(**turn_to(force))),
        shaft_length=0.8 * length,
        shaft_diameter=RADIUS_M / 2,
        head_length=0.2 * length,
        head_diameter=RADIUS_M,
        color=Color(r=0.1, g=0.1, b=0.1, a=1.0),
    )
    return SceneEntity(
        timestamp=Timestamp(at_ns // 10**9, at_ns % 10**9),
        frame_id=frame_id,
        id="skin",
        spheres=spheres,
        arrows=[arrow] if length else [],
    )


def _vector(place: NDArray[np.float64]) -> Vector3:
    x, y, z = place.tolist()
    return Vector3(x=x, y=y, z=z)


def turn_to(direction: NDArray[np.float64]) -> dict[str, float]:
    """The turn from +x to a direction, half way between the two, as a quaternion."""
    length = float(np.linalg.norm(direction))
    x, y, z = (direction / length).tolist() if length else (1.0, 0.0, 0.0)
    if x < -1.0 + 1e-9:
        return {"x": 0.0, "y": 0.0, "z": 1.0, "w": 0.0}
    w = 1.0 + x
    norm = float(np.sqrt(w * w + z * z + y * y))
    return {"x": 0.0, "y": -z / norm, "z": y / norm, "w": w / norm}
