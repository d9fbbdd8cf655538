"""The LASA contact data are read as they are, or refused."""

from pathlib import Path

import numpy as np
import pytest

from taxel.errors import RecordingError
from taxel_models.recordings.lasa import read_lasa_columns


def test_columns_are_read_as_they_are(tmp_path: Path) -> None:
    (tmp_path / "F1_force.txt").write_text("0.5 0 -1\n0 0 -2\n")
    (tmp_path / "F1_electrodes.txt").write_text("\n".join([" ".join(map(str, range(19)))] * 2))
    force, electrodes = read_lasa_columns(tmp_path, "F1")
    np.testing.assert_array_equal(force, [[0.5, 0.0, -1.0], [0.0, 0.0, -2.0]])
    np.testing.assert_array_equal(electrodes, [np.arange(19.0)] * 2)


@pytest.mark.parametrize("force", [None, "no number\n"])
def test_what_is_missing_or_damaged_is_told(tmp_path: Path, force: str | None) -> None:
    if force is not None:
        (tmp_path / "F2_force.txt").write_text(force)
    with pytest.raises(RecordingError, match="expected the LASA contact data"):
        read_lasa_columns(tmp_path, "F2")
