"""The twin against recordings of real fingers."""

from pathlib import Path

import pytest

from taxel_models.recordings.lasa import FINGERS
from taxel_models.twin import simulate
from taxel_models.twin.measured_comparison import (
    BINS_N,
    MOVED,
    PRESSED,
    RISE,
    comparable,
    figures,
    lasa,
)

TOLERANCE = 0.4
"""A ball on a round fingertip and a flat plate under it are not the same contact."""


@pytest.mark.measured
def test_the_twin_answers_force_as_real_fingers_do(data_folder: Path) -> None:
    made = figures(comparable(simulate(300_000, 7)))
    real = [figures(lasa(data_folder / "lasa_contact", finger)) for finger in FINGERS]
    # Below 3 N the real recordings' own reference is pressed: there only the sign can be compared.
    for low, high in BINS_N[1:]:
        name = PRESSED.format(low, high)
        mean = sum(column[name] for column in real) / len(real)
        assert made[name] == pytest.approx(mean, rel=TOLERANCE), name
    assert made[PRESSED.format(*BINS_N[0])] < 0
    rises = [column[RISE] for column in real]
    assert 0.6 * min(rises) < made[RISE] < 1.4 * max(rises)
    moved = [column[MOVED] for column in real]
    assert min(moved) - 3 <= made[MOVED] <= max(moved) + 3
