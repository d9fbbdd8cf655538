"""The rule for electrode glitches, at its limits."""

import numpy as np
import pytest

from taxel_models.recordings.glitches import GLITCH_COUNTS, GLITCH_ROWS, NEAR_ZERO_COUNTS, glitches

HIGH = GLITCH_COUNTS + 1.0
LOW = NEAR_ZERO_COUNTS - 1.0


def rows_of(*electrode: float) -> list[int]:
    found = glitches(np.column_stack([np.zeros(len(electrode)), electrode]))
    return np.flatnonzero(found).tolist()


@pytest.mark.parametrize("length", range(1, GLITCH_ROWS + 1))
def test_a_short_jump_and_back_is_a_glitch(length: int) -> None:
    assert rows_of(0, LOW, *[HIGH] * length, LOW, 0) == list(range(2, 2 + length))


@pytest.mark.parametrize(
    "signal",
    [
        (0, 0, GLITCH_COUNTS, 0, 0),
        (0, NEAR_ZERO_COUNTS, HIGH, 0, 0),
        (0, 0, HIGH, NEAR_ZERO_COUNTS, 0),
        (0, *[HIGH] * (GLITCH_ROWS + 1), 0),
        (0, HIGH, NEAR_ZERO_COUNTS, HIGH, 0),
        (HIGH, HIGH),
        (HIGH,),
        (),
    ],
    ids=[
        "at the limit",
        "from afar",
        "not back",
        "too long",
        "a dip in a rise",
        "high throughout",
        "one row",
        "none",
    ],
)
def test_anything_else_is_a_signal(signal: tuple[float, ...]) -> None:
    assert rows_of(*signal) == []


def test_at_an_end_the_one_neighbour_decides() -> None:
    assert rows_of(HIGH, 0, 0, HIGH, HIGH) == [0, 3, 4]
    assert rows_of(HIGH, LOW + 1, 0, LOW + 1, HIGH) == []


def test_glitches_are_judged_electrode_by_electrode() -> None:
    electrodes = np.zeros((6, 2))
    electrodes[2, 0] = electrodes[3, 1] = HIGH
    assert np.flatnonzero(glitches(electrodes)).tolist() == [2, 3]
