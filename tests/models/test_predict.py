"""`taxel predict` refuses what would lose something, or would give nothing."""

from pathlib import Path

import pytest

from taxel.errors import RecordingError, SettingsError
from taxel_models.commands.predict import predict
from taxel_models.recordings import write_ruppel
from taxel_models.twin import simulate


def test_a_recording_is_not_overwritten_by_its_prediction(tmp_path: Path) -> None:
    path = tmp_path / "twin.csv"
    write_ruppel(simulate(600, 1), path)
    before = path.read_bytes()
    with pytest.raises(SettingsError, match=r"twin\.csv is what is read: expected another place"):
        predict(path, "xgb", path)
    assert path.read_bytes() == before


def test_a_recording_without_a_whole_window_is_refused(tmp_path: Path) -> None:
    path, output = tmp_path / "twin.csv", tmp_path / "out.csv"
    write_ruppel(simulate(600, 1).rows(slice(0, 20)), path)
    with pytest.raises(
        RecordingError, match=r"holds no whole window: expected segments of at least \d+ ticks"
    ):
        predict(path, "xgb", output)
    assert not output.exists()
