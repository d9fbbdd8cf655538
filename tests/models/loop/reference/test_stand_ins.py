"""Stand-ins: each row is predicted by trees that never saw its contact, or its kind."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest

from taxel.channels import CHANNELS
from taxel_models.loop.observations import Observations, gather
from taxel_models.loop.reference import held_out
from taxel_models.loop.reference.held_out import held_out_residual
from taxel_models.loop.reference.stand_ins import without_their_contact, without_their_kind
from taxel_models.recordings import Recording

Make = Callable[..., Recording]

FROM, TO = CHANNELS.index("e10"), CHANNELS.index("e11")


@pytest.fixture(scope="module")
def make(make: Make) -> Make:
    """Recordings without materials: each would be compared by itself, which takes most of the time."""
    return partial(make, materials=False)


@pytest.fixture(scope="module")
def some(smooth: Any, make: Make) -> Observations:
    return gather(smooth, [make(3_000, seed=5)])


def test_a_stand_in_never_saw_the_kind_that_it_predicts(some: Observations) -> None:
    values = np.resize(np.repeat([1.0, 2.0, 3.0], 50), len(some))
    several = replace(some, covariates={"material": values})
    first = without_their_kind(several, "material").predicted
    moved = several.measured + np.where(values == 2.0, 500.0, 0.0)[:, None]
    second = without_their_kind(replace(several, measured=moved), "material").predicted
    np.testing.assert_array_equal(second[values == 2.0], first[values == 2.0])
    assert np.median(np.abs(second - first)[values != 2.0]) > 50.0


def test_a_stand_in_never_saw_the_contact_that_it_predicts(some: Observations) -> None:
    contact = some.contact
    chosen = contact == np.unique(contact)[3]
    first = without_their_contact(some)
    second = without_their_contact(replace(some, measured=some.measured + 500.0 * chosen[:, None]))
    assert first is not None
    assert second is not None
    np.testing.assert_array_equal(second.predicted[chosen], first.predicted[chosen])
    assert np.abs(second.predicted - first.predicted)[~chosen].max() > 1.0


def test_a_stand_in_predicts_moved_inputs(some: Observations) -> None:
    """A turned finger is looked for by new predictions, of the same trees."""
    found = without_their_contact(some)
    assert found is not None
    same = found.with_windows(found.windows, shift_ticks=0)
    np.testing.assert_array_equal(same.predicted, found.predicted)
    # Any rows may be asked for, in any order.
    rows = np.random.default_rng(0).permutation(len(found))[:500]
    again = found.model.predict(found.windows[rows])
    np.testing.assert_array_equal(again, found.predicted[rows].astype(np.float32))
    windows = found.windows.copy()
    windows[:, :-1] *= 0.5
    assert np.abs(found.with_windows(windows, shift_ticks=0).predicted - found.predicted).max() > 1.0


def test_of_few_contacts_a_stand_in_sees_three_quarters(some: Observations) -> None:
    """Half of few contacts tell much less than all, so that stand-ins would err by more than the model."""
    few = without_their_contact(some)
    many = without_their_contact(replace(some, segment=np.arange(len(some)) // 20))
    groups = [] if few is None or many is None else [_groups(few), _groups(many)]
    assert groups == [4, 2]


def _groups(observations: Observations) -> int:
    """How many groups of contacts are left out, one after the other."""
    return len(np.unique(observations.windows[:, -1]))


def test_few_contacts_have_no_stand_ins(some: Observations) -> None:
    few = some.kept(some.contact <= np.unique(some.contact)[3])
    assert without_their_contact(few) is None


def apart(recording: Recording, seed: int, counts: float) -> Recording:
    """Every second of it is off by other counts."""
    random = np.random.default_rng(seed)
    offsets = counts * random.standard_normal((len(recording) // 100 + 1, 21))
    return replace(recording, channels=recording.channels + offsets[np.arange(len(recording)) // 100])


@pytest.mark.usefixtures("quick_references")
def test_what_few_contacts_leave_open_is_known_of_all(smooth: Any, make: Make) -> None:
    """Means of some contacts scatter; those of many tell better how far a recording's mean may lie."""
    few, many = apart(make(2_200, seed=8), 1, 30.0), apart(make(11_000, seed=9), 2, 30.0)
    alone = held_out_residual(smooth, [few])
    known = held_out_residual(smooth, [few], [many])
    assert alone is not None
    assert known is not None
    assert known.rows > 5 * alone.rows
    assert sum(known.structure["offset"].gain) < 0.5 * sum(alone.structure["offset"].gain)


@pytest.mark.usefixtures("quick_references")
def test_what_only_the_model_gets_wrong_is_known_with_all_contacts(smooth: Any, make: Make) -> None:
    """Trees follow whatever is in the recordings. The model does not: its own held-out rows say so."""
    few, many = (
        replace(one, channels=one.channels + 0.002 * (one.channels - 2000.0) ** 2)
        for one in (make(2_500, seed=8), make(4_000, seed=9))
    )
    known = held_out_residual(smooth, [few], [many])
    alone = held_out_residual(smooth, [few])
    assert alone is not None
    assert known is not None
    own, all_of_it = (sum(one.structure["gain"].gain) for one in (alone, known))
    assert own > 0.0
    assert all_of_it > 0.3 * own


@pytest.mark.usefixtures("quick_references")
def test_few_contacts_and_all_that_was_fitted_are_a_reference(smooth: Any, make: Make) -> None:
    """Training held out 5 s: too little by itself."""
    few, many = make(500, seed=8), make(2_000, seed=9)
    assert held_out_residual(smooth, [few]) is None
    known = held_out_residual(smooth, [few], [many])
    assert known is not None
    assert known.rows == len(gather(smooth, [few, many]))


@pytest.mark.usefixtures("quick_references")
def test_a_leak_that_only_the_model_lacks_is_known_beside_all_channels(smooth: Any, make: Make) -> None:
    """It was in all recordings: trees learned it, and the model did not."""
    rest = smooth.counts(np.zeros((1, 3)), np.zeros((1, 3)))[0]
    recordings = [make(rows, seed=seed) for rows, seed in ((2_200, 8), (3_500, 9))]
    for recording in recordings:
        recording.channels[:, TO] += 0.5 * (recording.channels[:, FROM] - rest[FROM])
    few, many = recordings
    known = held_out_residual(smooth, [few], [many])
    alone = held_out_residual(smooth, [many])
    assert known is not None
    assert known.correlated is not None
    assert alone is not None
    assert alone.correlated is not None
    of_all, own = (found.structure["crosstalk"].gain[TO] for found in (known.correlated, alone.correlated))
    assert own > 0.0
    assert of_all > 0.5 * own


@pytest.mark.usefixtures("quick_references")
def test_of_long_recordings_some_contacts_count(
    smooth: Any, make: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    few, many = make(600, seed=8), make(4_000, seed=9)
    monkeypatch.setattr(held_out, "MOST_ROWS", 2_500)
    known = held_out_residual(smooth, [few], [many])
    assert known is not None
    whole = gather(smooth, [few, many])
    longest = int(np.unique(whole.contact, return_counts=True)[1].max())
    assert 2_500 <= known.rows < 2_500 + longest
