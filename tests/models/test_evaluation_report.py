"""The folder of an evaluation."""

from pathlib import Path

import numpy as np

from taxel.manifest import Normalisation
from taxel_models.evaluation.evaluation_report import write_report


def test_names_are_escaped_and_every_channel_has_its_baseline(tmp_path: Path) -> None:
    random = np.random.default_rng(1)
    measured = random.normal(size=(40, 21)) + np.arange(21.0)
    write_report(
        tmp_path / "report",
        about={"model": "xgb/1", "recording": "*a|b*.csv"},
        time_ns=np.arange(40, dtype=np.int64) * 10_000_000,
        measured=measured,
        predicted=(measured + 0.5).astype(np.float32),
        normalisation=Normalisation(
            input_mean=(0.0,) * 9, input_std=(1.0,) * 9, output_mean=(0.0,) * 21, output_std=(2.0,) * 21
        ),
    )
    text = (tmp_path / "report" / "errors.md").read_text(encoding="utf-8")
    assert "- recording: \\*a\\|b\\*.csv" in text
    for channel in (5, 20):
        baseline = np.abs(measured[:, channel]).mean() / 2.0
        assert f"| e{channel - 1} | 0.50 | 0.250 | {baseline:.3f} |" in text
