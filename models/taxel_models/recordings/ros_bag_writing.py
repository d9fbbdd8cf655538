"""Recordings as bags of ROS 2: an MCAP file, or a rosbag2 folder."""

import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from taxel.atomic import whole_file, whole_folder
from taxel.channels import CHANNELS, COUNTS_MAX
from taxel.dependencies import require
from taxel.errors import RecordingError, SettingsError
from taxel.ros2.messages import BIOTAC_ALL, POINT, WRENCH, biotac_all, header_of
from taxel.ros2.settings import NodeSettings
from taxel.ros2.topics import HAND_TOPIC
from taxel_models.recordings.recording import Recording
from taxel_models.recordings.ros_bag import COVARIATE, COVARIATES

_COUNTS: Final = np.iinfo(np.int16)
_VERSION: Final = 9
"""Of rosbag2's metadata: Jazzy's and newer."""


def write_ros_bag(recording: Recording, path: Path, finger: str = "ff") -> None:
    """Write a recording with a node's topics; `read_ros_bag` gives back equal columns.

    Args:
        recording: whose channels are whole 12-bit counts.
        path: ends in `.mcap`, and will be an MCAP file; otherwise a rosbag2 folder with an sqlite3 file. It
            appears whole or not at all.
        finger: of `taxel.ros2.settings.SHADOW_FINGERS`.

    Raises:
        RecordingError: there are no rows, or counts that BiotacAll cannot hold.
        SettingsError: `path` cannot be written, or a covariate's name cannot be part of a topic's.
        MissingDependency: the extra `ros2` is not installed.
    """
    require("a bag of ROS", "ros2", "rosbags")
    _check(recording, path)
    try:
        if path.suffix != ".mcap":
            with whole_folder(path) as folder:
                # The files are named after the folder that rosbags makes.
                named = folder / path.name
                _write(recording, named, finger, "SQLITE3")
                for file in named.iterdir():
                    file.rename(folder / file.name)
                named.rmdir()
            return
        with whole_file(path) as temporary, tempfile.TemporaryDirectory(dir=path.parent) as place:
            folder = Path(place) / path.stem
            _write(recording, folder, finger, "MCAP")
            (written,) = folder.glob("*.mcap")
            shutil.move(written, temporary)
    except OSError as error:
        raise SettingsError(f"{path}: cannot be written: {error.strerror}") from None


def _write(recording: Recording, folder: Path, finger: str, plugin: str) -> None:
    from rosbags.rosbag2 import StoragePlugin, Writer

    from taxel.ros2.cdr import encode, typestore

    topics = {f"/{HAND_TOPIC}": BIOTAC_ALL, f"/{finger}/wrench": WRENCH, f"/{finger}/point": POINT}
    topics |= {f"/{finger}{COVARIATES}{name}": COVARIATE for name in recording.covariates}
    with Writer(folder, version=_VERSION, storage_plugin=StoragePlugin[plugin]) as bag:
        connections = [
            bag.add_connection(name, kind, typestore=typestore()) for name, kind in topics.items()
        ]
        for time_ns, messages in _messages(recording, finger):
            for connection, message in zip(connections, messages, strict=True):
                bag.write(connection, time_ns, encode(message, connection.msgtype))


def _messages(recording: Recording, finger: str) -> Iterator[tuple[int, list[Any]]]:
    """The time of each row, and its messages in the order of the topics."""
    from taxel.ros2.cdr import CdrTypes

    types = CdrTypes()
    frame = NodeSettings().frame_of(finger)
    vector, point = types.type_of("geometry_msgs/msg/Vector3"), types.type_of("geometry_msgs/msg/Point")
    wrench, number = types.type_of("geometry_msgs/msg/Wrench"), types.type_of(COVARIATE)
    torque = vector(x=0.0, y=0.0, z=0.0)
    samples = recording.samples
    for row, time_ns in enumerate(samples.time_ns.tolist()):
        header = header_of(types, time_ns, frame)
        further = {name: float(values[row]) for name, values in recording.auxiliary.items()}
        channels = recording.channels[row].astype(np.float32)
        force = wrench(force=vector(*samples.force[row].tolist()), torque=torque)
        yield (
            time_ns,
            [
                biotac_all(types, time_ns, {finger: channels}, further),
                types.type_of(WRENCH)(header=header, wrench=force),
                types.type_of(POINT)(header=header, point=point(*samples.position[row].tolist())),
                *(number(data=float(values[row])) for values in recording.covariates.values()),
            ],
        )


def _check(recording: Recording, path: Path) -> None:
    """Refuse what messages cannot hold."""
    if not len(recording):
        raise RecordingError(f"{path}: {recording.name} has no rows; expected at least one to write")
    times = recording.samples.time_ns
    if times[0] <= 0 or times[-1] >= 2**31 * 1_000_000_000:
        raise RecordingError(
            f"{path}: times {times[0]} to {times[-1]} ns; expected times from 1970 to 2038"
        )
    columns = dict(zip(CHANNELS, recording.channels.T, strict=True))
    for name, values in columns.items():
        _check_counts(path, name, values, 0, COUNTS_MAX)
    for name, values in recording.auxiliary.items():
        _check_counts(path, name, values, _COUNTS.min, _COUNTS.max)
    for name in recording.covariates:
        if not (name.isascii() and name.isidentifier()):
            raise SettingsError(
                f"{path}: covariate {name!r} cannot be part of a topic's name; expected letters, digits "
                "and underscores"
            )


def _check_counts(path: Path, name: str, values: NDArray[np.float64], least: int, most: int) -> None:
    wrong = (values != np.rint(values)) | (values < least) | (values > most)
    if wrong.any():
        row = int(np.argmax(wrong))
        raise RecordingError(
            f"{path}: {name} is {values[row]:g} in row {row}; expected whole counts from {least} to "
            f"{most}, as {BIOTAC_ALL} holds them"
        )
