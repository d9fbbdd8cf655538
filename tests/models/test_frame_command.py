"""The drawing of the sensor's frame."""

from pathlib import Path

import pytest
import typer

from taxel.channels import ELECTRODES
from taxel_models.commands.frame import drawing, frame


def test_every_electrode_is_drawn_at_its_place(tmp_path: Path) -> None:
    side, below = drawing().axes
    assert {text.get_text() for text in below.texts} >= set(ELECTRODES)
    assert {text.get_text() for text in side.texts} >= {"x", "z", "e7", "e16"}
    frame(tmp_path / "frame.svg")
    assert "<svg" in (tmp_path / "frame.svg").read_text()


def test_another_kind_of_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(typer.BadParameter, match=r"frame\.gif: expected a name that ends with \.svg"):
        frame(tmp_path / "frame.gif")
