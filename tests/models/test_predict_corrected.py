"""`taxel predict` gives a corrected model its features of the past and the recording's own columns."""

from pathlib import Path

import numpy as np

import taxel
from taxel.channels import CHANNELS
from taxel.corrections import AppliedEffect, Weighted
from taxel.windows import ExtraFeature, Play, build_windows, history_columns
from taxel_exporters.corrected import export_corrected
from taxel_exporters.export import export
from taxel_models.commands.predict import predict
from taxel_models.recordings import read_recording, write_ruppel
from taxel_models.twin import simulate

PLAY = Play(of="force", width_n=0.2)


def test_a_recording_goes_through_a_corrected_model(trained_folder: Path, tmp_path: Path) -> None:
    repository, path = tmp_path / "repository", tmp_path / "twin.csv"
    export(trained_folder, repository, name="finger")
    extras = (
        ExtraFeature(name="tdc", unit="counts", default=0.0, taken_by="effects"),
        ExtraFeature(name="play", unit="N", history=PLAY, taken_by="effects"),
    )
    term = Weighted(
        shape="unit",
        features=("tdc", "play"),
        references=(1900.0, 0.0),
        weights=((1.0,) * 21, (50.0,) * 21),
    )
    effect = AppliedEffect(name="both", about="Two.", channels=CHANNELS, terms=(term,))
    check = np.zeros((3, 12), np.float32)
    export_corrected(repository, "finger", "1", [effect], extras, windows=check)
    write_ruppel(simulate(600, 1), path)
    predict(path, "finger", tmp_path / "out.csv", repository=repository, as_json=True)
    found = np.loadtxt(tmp_path / "out.csv", delimiter=",", skiprows=1)[:, 1:]
    recording = read_recording(path)
    with taxel.load(repository) as source:
        base = source.predictor("finger", "1")
        windows = build_windows(recording.samples, base.window)
        p = base.predict(windows.values)
    play = history_columns(recording.samples, [PLAY])[windows.rows]
    tdc = recording.auxiliary["tdc"][windows.rows, None]
    assert np.ptp(play) > 0.1
    np.testing.assert_allclose(found, p + (tdc - 1900) + 50 * play, atol=0.02)
