"""What a recording of one kind may show, if few contacts of it were held out."""

import numpy as np
import pytest
from scipy import stats

from taxel_models.loop.reference.gain_limit import RECORDED
from taxel_models.loop.reference.one_kind import (
    FURTHER_KIND,
    OF_ALL_KINDS,
    _further_may_show,
    moderated_limit,
)


@pytest.mark.parametrize("contacts", [1, 2, 5, 12])
def test_recordings_of_kinds_that_scatter_stay_below_it_as_often_as_it_says(contacts: int) -> None:
    """Kinds have energies of their own; of each, few contacts are known, and a recording has others."""
    random = np.random.default_rng(3)
    draws = 40_000
    of_kind = OF_ALL_KINDS / random.chisquare(OF_ALL_KINDS, draws)
    own = of_kind * random.chisquare(contacts, draws) / contacts
    recorded = of_kind * random.chisquare(RECORDED, draws) / RECORDED
    # For known kinds, 5 % of recordings have more than so many times the kind's energy.
    many = stats.chi2.ppf(0.95, RECORDED) / RECORDED
    limit = many * moderated_limit(own, np.ones(draws), contacts)
    assert np.mean(recorded > limit) == pytest.approx(0.05, abs=0.004)


@pytest.mark.parametrize(
    ("kinds", "differ"),
    [(3, 0.5), pytest.param(6, 1.0, marks=pytest.mark.long), pytest.param(12, 0.3, marks=pytest.mark.long)],
)
def test_a_further_kind_stays_below_what_it_may_show(kinds: int, differ: float) -> None:
    """Gains of kinds differ by factors, and a kind more is as those are."""
    random = np.random.default_rng(7)
    beyond, draws = 0, 3_000
    for _ in range(draws):
        gains = np.exp(differ * random.normal(size=(kinds + 1, 8)))
        known = [
            {f"effect{one}": np.full((2, 21), gain) for one, gain in enumerate(own)} for own in gains[:-1]
        ]
        limits = _further_may_show(known)
        beyond += sum(gains[-1, one] > limits[f"effect{one}"][1, 0] for one in range(8))
    assert beyond / (8 * draws) <= 1.5 * (1.0 - FURTHER_KIND)


def test_what_no_kind_shows_a_further_one_does_not() -> None:
    nothing = _further_may_show([{"fault": np.zeros((2, 21))} for _ in range(4)])
    np.testing.assert_array_equal(nothing["fault"], 0.0)


def test_many_contacts_tell_what_their_kind_has() -> None:
    own, mean = np.array([0.5, 4.0]), np.array([1.0, 1.0])
    np.testing.assert_allclose(moderated_limit(own, mean, 1_000_000), own, rtol=1e-4)


def test_what_no_contact_tells_the_mean_over_kinds_does() -> None:
    few = moderated_limit(np.array([9.0]), np.array([1.0]), 0)
    assert few == pytest.approx(moderated_limit(np.array([1.0]), np.array([1.0]), 0))
    assert few[0] > 2.0
