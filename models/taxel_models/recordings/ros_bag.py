"""Bags of ROS as recordings: a finger of `sr_robot_msgs/BiotacAll` with its contacts."""

import hashlib
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from taxel.channels import CHANNELS, ELECTRODES
from taxel.dependencies import require
from taxel.errors import RecordingError, TaxelError
from taxel.ros2.messages import BIOTAC_ALL, CONTACT, POINT, WRENCH, stamp_ns_of, vector_of
from taxel.ros2.settings import SHADOW_FINGERS
from taxel.windows.samples import GAP_NS
from taxel_models.recordings.alignment import bracket_s, interpolated
from taxel_models.recordings.recording import AUXILIARY, Recording

SUFFIXES: Final = (".mcap", ".db3", ".bag")
"""A file with one of these is a bag, and so is a folder with a `metadata.yaml`."""

COVARIATE: Final = "std_msgs/msg/Float64"
COVARIATES: Final = "/covariates/"
"""Numbers on topics below a topic of this name are covariates."""

OUTSIDE: Final = "before or after the contacts"
NO_SENSOR: Final = "no electrodes of this finger"
NO_CONTACT: Final = f"no contact within {GAP_NS // 1_000_000} ms"


class _Series(NamedTuple):
    """What a topic says over time.

    Attributes:
        topic: its name.
        time_ns: (n,) int64, of the messages' headers.
        values: (n, k).
        frames: the frames that its messages name.
    """

    topic: str
    time_ns: NDArray[np.int64]
    values: NDArray[np.float64]
    frames: frozenset[str]


def is_ros_bag(path: Path) -> bool:
    """Whether a path looks like a bag of ROS."""
    return path.suffix in SUFFIXES or (path / "metadata.yaml").is_file()


def read_ros_bag(path: Path, finger: str | None = None) -> Recording:
    """Read one finger from a rosbag2 folder, an MCAP or sqlite3 file, or a bag of ROS 1.

    A row is a message of BiotacAll, at the time of its header. Force and place are interpolated to it
    linearly, from WrenchStamped and PointStamped, or from TactileContact. Where there is no force, no point
    is needed. Rows without contacts around them, or without electrodes, are dropped and counted. Topics of
    Float64 below `covariates/` are covariates.

    Args:
        path: the bag.
        finger: of `SHADOW_FINGERS`; if not given, the only one that has contacts.

    Raises:
        RecordingError: the bag is damaged, topics are missing, several could be meant, they name different
            frames, or time does not increase.
        MissingDependency: the extra `ros2` is not installed.
    """
    require("a bag of ROS", "ros2", "rosbags")
    with _opened(path) as bag:
        topics = _topics(bag)
        finger = _finger(path, topics) if finger is None else finger
        hand = _one(path, topics, BIOTAC_ALL, "")
        contact = _one(path, topics, CONTACT, finger, needed=WRENCH not in topics)
        names = [contact] if contact else [_one(path, topics, kind, finger) for kind in (WRENCH, POINT)]
        covariates = [name for name in topics[COVARIATE] if COVARIATES in name]
        series = _read(path, bag, [hand, *names, *covariates], SHADOW_FINGERS.index(finger))
    contacts = [series[name] for name in names]
    _check_frames(path, contacts)
    further = {name.partition(COVARIATES)[2]: series[name] for name in covariates}
    return _recording(path, series[hand], contacts, further)


def _recording(
    path: Path, hand: _Series, contacts: Sequence[_Series], further: dict[str, _Series]
) -> Recording:
    """Contacts and covariates at the times of the hand."""
    time = hand.time_ns
    wrench, point = contacts[0], contacts[-1]
    streams = [*contacts, *further.values()]
    inside = (time >= max(one.time_ns[0] for one in streams)) & (
        time <= min(one.time_ns[-1] for one in streams)
    )
    there = np.isfinite(hand.values).all(axis=1)
    kept = np.flatnonzero(inside & there)
    force = interpolated(time[kept], wrench.time_ns, wrench.values)[:, -3:]
    near = bracket_s(time[kept], wrench.time_ns) * 1e9 <= GAP_NS
    placed = bracket_s(time[kept], point.time_ns) * 1e9 <= GAP_NS
    near &= placed | ~force.any(axis=1)
    kept, force = kept[near], force[near]
    dropped = Counter({OUTSIDE: int((~inside).sum()), NO_SENSOR: int((inside & ~there).sum())})
    dropped[NO_CONTACT] = int((~near).sum())
    if not len(kept):
        reasons = ", ".join(f"{count} {reason}" for reason, count in dropped.items() if count)
        raise RecordingError(f"{path}: none of {len(time)} rows can be used: {reasons}")
    counts = hand.values[kept]
    return Recording.of(
        time[kept],
        interpolated(time[kept], point.time_ns, point.values)[:, :3],
        force,
        counts[:, : len(CHANNELS)],
        dict(zip(AUXILIARY, counts[:, len(CHANNELS) :].T, strict=True)),
        {name: interpolated(time[kept], one.time_ns, one.values)[:, 0] for name, one in further.items()},
        name=path.stem,
        format="ros_bag",
        sha256=_sha256(path),
        dropped={reason: count for reason, count in dropped.items() if count},
    )


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """The bag, open; whatever the reader finds wrong with it is told in one line."""
    from rosbags.highlevel import AnyReader

    from taxel.ros2.cdr import typestore

    try:
        with AnyReader([path], default_typestore=typestore()) as bag:
            yield bag
    except TaxelError:
        raise
    except Exception as error:  # what readers of damaged bytes raise has no base of its own
        told = str(error) or type(error).__name__
        raise RecordingError(f"{path}: cannot be read: {told}; expected a whole bag of ROS") from None


def _topics(bag: Any) -> dict[str, list[str]]:
    """The names of topics that have messages, by type."""
    topics: dict[str, list[str]] = defaultdict(list)
    for name, topic in sorted(bag.topics.items()):
        if topic.msgcount and topic.msgtype:
            topics[topic.msgtype].append(name)
    return topics


def _parts(name: str) -> list[str]:
    return name.strip("/").split("/")


def _finger(path: Path, topics: dict[str, list[str]]) -> str:
    names = [*topics[WRENCH], *topics[CONTACT]]
    found = [one for one in SHADOW_FINGERS if any(one in _parts(name) for name in names)]
    if len(found) != 1:
        several = f"contacts of {', '.join(found)}" if found else "no topic of contacts that names a finger"
        raise RecordingError(f"{path}: {several}; expected --finger, one of {', '.join(SHADOW_FINGERS)}")
    return found[0]


def _one(path: Path, topics: dict[str, list[str]], kind: str, finger: str, *, needed: bool = True) -> str:
    """The topic of a type that names the finger, or the only one of this type; "" if it is not needed."""
    names = topics[kind]
    named = [name for name in names if finger in _parts(name)] or (names if len(names) == 1 else [])
    if not finger:
        named = names
    if len(named) == 1:
        return named[0]
    if not needed and not named:
        return ""
    of = f" of finger {finger!r}" if finger else ""
    raise RecordingError(
        f"{path}: {len(named)} topics of {kind}{of}{': ' if names else ''}{', '.join(names)}; expected one"
    )


def _read(path: Path, bag: Any, names: Sequence[str], finger: int) -> dict[str, _Series]:
    """The messages of these topics.

    Raises:
        RecordingError: a stamp does not follow the one before, or electrodes are missing.
    """
    times: dict[str, list[int]] = defaultdict(list)
    rows: dict[str, list[Sequence[float]]] = defaultdict(list)
    frames: dict[str, set[str]] = defaultdict(set)
    wanted = [connection for connection in bag.connections if connection.topic in names]
    for connection, logged_ns, payload in bag.messages(connections=wanted):
        name, kind = connection.topic, connection.msgtype
        message = bag.deserialize(payload, kind)
        where = f"{path}: {name}, message {len(times[name]) + 1}"
        if kind == COVARIATE:
            time_ns = logged_ns
        else:
            time_ns = stamp_ns_of(message.header)
            frames[name].add(str(message.header.frame_id))
        if times[name] and time_ns <= times[name][-1]:
            raise RecordingError(
                f"{where}: time {time_ns} ns follows {times[name][-1]} ns; expected time to increase"
            )
        times[name].append(time_ns)
        rows[name].append(_numbers(where, message, kind, finger))
    for name in names:
        read, told = len(times[name]), bag.topics[name].msgcount
        if read != told:
            raise RecordingError(
                f"{path}: {name}: {read} messages; expected {told}, as the bag's summary says"
            )
    return {
        name: _Series(
            name, np.array(times[name], np.int64), _finite(path, name, rows[name]), frozenset(frames[name])
        )
        for name in names
    }


def _numbers(where: str, message: Any, kind: str, finger: int) -> Sequence[float]:
    """The numbers of a message; of a hand, NaN where the finger has no electrodes."""
    if kind == BIOTAC_ALL:
        tactile = message.tactiles[finger]
        if not len(tactile.electrodes):
            return [np.nan] * (len(CHANNELS) + len(AUXILIARY))
        if len(tactile.electrodes) != len(ELECTRODES):
            raise RecordingError(
                f"{where}: {len(tactile.electrodes)} electrodes; expected {len(ELECTRODES)}"
            )
        further = [getattr(tactile, name) for name in AUXILIARY]
        return [tactile.pac0, tactile.pdc, *tactile.electrodes, *further]
    if kind == COVARIATE:
        return [message.data]
    if kind == POINT:
        return vector_of(message.point)
    place = vector_of(message.position) if kind == CONTACT else ()
    return [*place, *vector_of(message.wrench.force)]


def _finite(path: Path, name: str, rows: Sequence[Sequence[float]]) -> NDArray[np.float64]:
    values = np.array(rows, np.float64)
    # NaN is ours where a hand lacks a finger.
    wrong = ~np.isfinite(values).all(axis=1) if values.shape[1] < len(CHANNELS) else np.zeros(0, np.bool_)
    if wrong.any():
        row = int(np.argmax(wrong))
        raise RecordingError(
            f"{path}: {name}, message {row + 1}: {values[row].tolist()}; expected finite numbers"
        )
    return values


def _check_frames(path: Path, contacts: Sequence[_Series]) -> None:
    """Refuse contacts in several frames: they cannot all be in the sensor's."""
    named = {frame for one in contacts for frame in one.frames}
    if len(named) > 1:
        topics = ", ".join(f"{one.topic} in {', '.join(map(repr, sorted(one.frames)))}" for one in contacts)
        raise RecordingError(f"{path}: {topics}; expected one frame, the sensor's")


def _sha256(path: Path) -> str:
    """Of a file; of a folder, of its files' names and hashes."""
    if path.is_file():
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    files = sorted(one for one in path.iterdir() if one.is_file())
    text = "".join(f"{one.name} {_sha256(one)}\n" for one in files)
    return hashlib.sha256(text.encode()).hexdigest()
