"""Recordings of files as a source."""

from collections.abc import Sequence
from pathlib import Path

from taxel.errors import RecordingError
from taxel_models.recordings import Recording, has_channels, read_recording
from taxel_watch.replay import Replay


def replay_of(paths: Sequence[Path]) -> Replay:
    """Recordings that play side by side, one a fingertip; those of one folder are one hand.

    Raises:
        RecordingError: one does not exist, is damaged, is empty, or has no measured channels.
    """
    recordings = [_read(path) for path in paths]
    names = [(path.resolve().parent.name, path.stem) for path in paths]
    return Replay(recordings, kind="recording", title=", ".join(map(str, paths)), names=names)


def _read(path: Path) -> Recording:
    if path.is_file() and not has_channels(path):
        raise RecordingError(f"{path}: has no measured channels; expected a recording, to replay it")
    recording = read_recording(path).ticks()
    if not len(recording):
        raise RecordingError(f"{path}: holds no rows; expected a recording, to replay it")
    return recording
