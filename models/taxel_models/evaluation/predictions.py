"""Predictions of a recording as a CSV file: `time_ns` and the 21 channels, one row for each window."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from taxel.atomic import whole_file
from taxel.channels import CHANNELS


def write_predictions(time_ns: NDArray[np.int64], channels: NDArray[np.float32], path: Path) -> None:
    """Write predictions; the file appears whole or not at all.

    Args:
        time_ns: (n,) the time T of each window.
        channels: (n, 21) counts, written so that reading gives the same float32.

    Raises:
        SettingsError: the folder of `path` does not exist.
    """
    rows = zip(time_ns.tolist(), channels.astype(str).tolist(), strict=True)
    with whole_file(path) as temporary, temporary.open("w", encoding="ascii") as file:
        file.write(",".join(("time_ns", *CHANNELS)) + "\n")
        file.writelines(f"{time},{','.join(values)}\n" for time, values in rows)
