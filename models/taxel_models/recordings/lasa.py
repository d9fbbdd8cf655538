"""The LASA contact format: forces and electrodes of a finger that is pressed on a flat force sensor."""

from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from taxel.errors import RecordingError

FINGERS: Final = ("F1", "F2")


def read_lasa_columns(folder: Path, finger: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The forces (n, 3), N, and the electrodes (n, 19), counts, of one of `FINGERS`.

    They are no recording: the format has no time stamps, positions, pressure or temperature.

    Raises:
        RecordingError: the files are not there, or hold other than numbers.
    """
    try:
        force = np.loadtxt(folder / f"{finger}_force.txt")
        electrodes = np.loadtxt(folder / f"{finger}_electrodes.txt")
    except (OSError, ValueError) as error:
        raise RecordingError(f"{folder}: {error}; expected the LASA contact data") from None
    return force, electrodes
