"""Real recordings load whole, and what is dropped adds up."""

import warnings
from pathlib import Path

import numpy as np
import pytest

from taxel.channels import COUNTS_MAX, ELECTRODE_COLUMNS
from taxel.errors import InputWarning
from taxel_models.recordings import read_recording, write_ruppel
from taxel_models.recordings.slide import GLITCH

pytestmark = pytest.mark.measured


@pytest.mark.parametrize(
    ("material", "glitch_rows", "told"),
    [
        (1, 0, []),
        (2, 4, ["mat2: 5 rows jump far away and back, in e3"]),
        (9, 1, ["mat9: 3 rows jump far away and back, in e3"]),
    ],
)
def test_a_real_material_loads(data_folder: Path, material: int, glitch_rows: int, told: list[str]) -> None:
    """The rows that are told jump by 220 counts, too little to be dropped."""
    folder = data_folder / "biotac_slide" / f"mat{material}"
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        recording = read_recording(folder)
    assert [str(warning.message) for warning in warned] == told
    published = sum(path.read_bytes().count(b"\n") - 1 for path in folder.glob("*_bio.csv"))
    assert len(recording) + sum(recording.dropped.values()) == published
    assert recording.dropped.get(GLITCH, 0) == glitch_rows
    assert len(recording.segments) == 25
    assert set(recording.covariates["material"]) == {material}
    firsts = [segment.start for segment in recording.segments]
    assert sorted(recording.covariates["trial"][firsts]) == list(range(1, 50, 2))
    assert recording.samples.are_ticks
    assert recording.channels.min() >= 0
    assert recording.channels.max() <= COUNTS_MAX
    assert recording.channels[:, ELECTRODE_COLUMNS].max() < 250
    assert np.ptp(recording.samples.position[:, 0]) > 0.1
    assert np.linalg.norm(recording.samples.force, axis=1).max() < 25


def test_a_real_material_survives_conversion(data_folder: Path, tmp_path: Path) -> None:
    recording = read_recording(data_folder / "biotac_slide" / "mat1")
    write_ruppel(recording, tmp_path / "mat1.csv")
    with pytest.warns(InputWarning, match="off the skin"):  # A slide folder's places are poses of a robot.
        again = read_recording(tmp_path / "mat1.csv")
    assert again.segments == recording.segments
    np.testing.assert_array_equal(again.samples.time_ns, recording.samples.time_ns)
    np.testing.assert_array_equal(again.samples.position, recording.samples.position)
    np.testing.assert_array_equal(again.samples.force, recording.samples.force)
    np.testing.assert_array_equal(again.channels, recording.channels)
    for name, values in recording.covariates.items():
        np.testing.assert_array_equal(again.covariates[name], values)
