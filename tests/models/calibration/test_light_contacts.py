"""Contact cycles and the light touch with which they end."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from taxel.channels import CHANNELS
from taxel.errors import RecordingError, SettingsError
from taxel_models.calibration.light_contacts import ORIENTATION, LightContacts
from taxel_models.calibration.limits import Limits
from taxel_models.recordings import Recording

CYCLE = [0.0, 0.1, 0.2, 0.5, 1.0, 0.4, 0.2, 0.1, 0.0]
"""Strong from row 3 on; its last light row is row 7."""


def recording(force: list[float], **covariates: np.ndarray) -> Recording:
    """Rows at x = 0, 1, 2 … mm."""
    rows = len(force)
    position = np.zeros((rows, 3))
    position[:, 0] = np.arange(rows) / 1e3
    return Recording.of(
        np.arange(rows) * 10_000_000,
        position,
        np.column_stack([np.zeros((rows, 2)), force]),
        np.zeros((rows, len(CHANNELS))),
        {name: np.zeros(rows) for name in ("pac1", "tac", "tdc")},
        covariates,
    )


def test_a_cycle_gives_its_start_and_its_last_light_row() -> None:
    contacts = LightContacts.of([recording(CYCLE * 25)], Limits())
    assert len(contacts) == 25
    starts = 9.0 * np.arange(25)
    np.testing.assert_allclose(contacts.first[:, 0], starts + 3)
    np.testing.assert_allclose(contacts.position[:, 0], starts + 7)
    assert contacts.orientation is None


def test_a_course_is_every_position_with_the_force_of_the_row_in_which_it_came() -> None:
    """Positions come every other row and are held; the force passes what Hertz's law covers."""
    force = [0.0, 0.0, 0.1, 0.2, 0.5, 2.0, 3.0, 0.6, 0.2, 0.15, 0.12, 0.1, 0.0, 0.0] * 20
    slow = recording(force)
    place = slow.samples.position.copy()
    place[1::2] = place[::2]
    slow = replace(slow, samples=replace(slow.samples, position=place))
    contacts = LightContacts.of([slow], Limits())
    assert len(contacts) == 20
    cycles = 14.0 * np.arange(20)[:, None]
    np.testing.assert_allclose(contacts.course[:, 0], (cycles + np.array([2, 4, 8, 10])).ravel())
    np.testing.assert_allclose(contacts.force, [0.1, 0.5, 0.2, 0.12] * 20)
    np.testing.assert_array_equal(contacts.starts, 4 * np.arange(20))
    np.testing.assert_allclose(contacts.position[:, 0], cycles[:, 0] + 10)


@pytest.mark.parametrize(
    "extra",
    [
        [0.0, 0.2, 0.25, 0.1, 0.0],  # never strong
        [0.0, 0.5, 1.0, 0.0],  # no light touch
        [0.0, 0.5, 0.2],  # still in touch when the recording ends
    ],
)
def test_what_is_no_whole_cycle_with_a_light_end_does_not_count(extra: list[float]) -> None:
    assert len(LightContacts.of([recording(CYCLE * 20 + extra)], Limits())) == 20


def by_hand(force: list[float], limits: Limits) -> Iterator[tuple[int, int]]:
    """Row by row, as the definition says."""
    first = last_strong = None
    for row, value in enumerate(force):
        if value <= limits.touch:
            if first is not None and last_strong is not None and last_strong < row - 1:
                yield first, row - 1
            first = last_strong = None
        elif value >= limits.light:
            first = row if first is None else first
            last_strong = row


@settings(deadline=None)
@given(st.lists(st.sampled_from([0.0, 0.05, 0.1, 0.29, 0.3, 1.0]), max_size=40))
def test_cycles_are_those_of_the_definition(force: list[float]) -> None:
    whole = CYCLE * 20 + force
    found = LightContacts.of([recording(whole)], Limits())
    expected = np.array(list(by_hand(whole, Limits())), dtype=float)
    np.testing.assert_allclose(found.first[:, 0], expected[:, 0], atol=1e-9)
    np.testing.assert_allclose(found.position[:, 0], expected[:, 1], atol=1e-9)


def test_too_few_are_refused_with_their_number() -> None:
    with pytest.raises(RecordingError, match=r"19 contact cycles end in a light touch .* at least 20"):
        LightContacts.of([recording(CYCLE * 10), recording(CYCLE * 9)], Limits())


def test_limits_out_of_order_are_refused() -> None:
    with pytest.raises(SettingsError, match="0 < touch < light"):
        Limits(touch=0.4, light=0.3)


def test_the_probes_orientation_is_taken_where_all_recordings_have_it() -> None:
    force = CYCLE * 20
    turns = {name: np.full(len(force), 0.5) for name in ORIENTATION}
    oriented = recording(force, **turns)
    contacts = LightContacts.of([oriented], Limits())
    assert contacts.orientation is not None
    np.testing.assert_array_equal(contacts.orientation, np.full((20, 4), 0.5))
    assert LightContacts.of([oriented, recording(force)], Limits()).orientation is None


def test_an_orientation_of_zero_is_named() -> None:
    force = CYCLE * 20
    turns = {name: np.full(len(force), 0.5) for name in ORIENTATION}
    for column in turns.values():
        column[16] = 0.0
    with pytest.raises(RecordingError, match="orientation in row 16 is zero"):
        LightContacts.of([recording(force, **turns)], Limits())
