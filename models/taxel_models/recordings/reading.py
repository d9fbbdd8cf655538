"""Reads a recording in any known format."""

from collections.abc import Callable
from pathlib import Path

from taxel.errors import RecordingError
from taxel_models.recordings.recording import Recording
from taxel_models.recordings.ruppel import read_ruppel
from taxel_models.recordings.slide import read_slide


def read_recording(path: Path, progress: Callable[[int, int], None] | None = None) -> Recording:
    """Read a Ruppel CSV file, or a BioTac slide folder.

    Args:
        path: the file, or the folder that holds trials.
        progress: called after each trial of a folder with the number read and the number in all.

    Raises:
        RecordingError: `path` does not exist, or is damaged; the text names the file, the line and
            what was expected.
    """
    if not path.exists():
        raise RecordingError(f"{path}: does not exist; expected a Ruppel CSV file or a BioTac slide folder")
    return read_slide(path, progress) if path.is_dir() else read_ruppel(path)
