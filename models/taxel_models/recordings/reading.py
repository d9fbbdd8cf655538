"""Reads a recording in any known format."""

from collections.abc import Callable
from pathlib import Path

from taxel.errors import RecordingError
from taxel.trained_contacts import TrainedContacts
from taxel_models.recordings.findings import check_recording
from taxel_models.recordings.recording import Recording
from taxel_models.recordings.ros_bag import is_ros_bag, read_ros_bag
from taxel_models.recordings.ruppel import read_ruppel
from taxel_models.recordings.slide import read_slide


def read_recording(
    path: str | Path,
    progress: Callable[[int, int], None] | None = None,
    *,
    finger: str | None = None,
    trained: TrainedContacts | None = None,
    strict: bool = False,
) -> Recording:
    """Read a Ruppel CSV file, a BioTac slide folder, or a bag of ROS; `InputWarning` says what looks wrong.

    Args:
        path: the file, or the folder.
        progress: called after each trial of a slide folder with the number read and the number in all.
        finger: of a bag with several fingers, the one to read.
        trained: the contacts of a model that is to predict it.
        strict: what looks wrong is an error.

    Raises:
        RecordingError: `path` does not exist, or is damaged; the text names the file, the line and
            what was expected. Or it looks wrong, and `strict` is true.
    """
    recording = read_unchecked(path, progress, finger=finger)
    check_recording(recording, trained, strict=strict)
    return recording


def read_unchecked(
    path: str | Path, progress: Callable[[int, int], None] | None = None, *, finger: str | None = None
) -> Recording:
    """As `read_recording`, for callers that look at what is wrong themselves.

    Raises:
        RecordingError: `path` does not exist, or is damaged; the text names the file, the line and
            what was expected.
    """
    path = Path(path)
    if not path.exists():
        raise RecordingError(
            f"{path}: does not exist; expected a Ruppel CSV file, a BioTac slide folder or a bag of ROS"
        )
    if is_ros_bag(path):
        return read_ros_bag(path, finger)
    return read_slide(path, progress) if path.is_dir() else read_ruppel(path)
