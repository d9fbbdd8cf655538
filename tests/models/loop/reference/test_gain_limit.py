"""How much another recording may show, if few contacts are known."""

import numpy as np
import pytest
from scipy import stats

from taxel_models.loop.reference.gain_limit import RECORDED, times_for_few


@pytest.mark.parametrize("confidence", [0.95, 0.99])
@pytest.mark.parametrize("freedom", [7, 11, 40])
def test_a_recording_seldom_scatters_more_than_few_known_contacts_allow(
    freedom: int, confidence: float
) -> None:
    """Contacts have offsets of one size; their scatter in a recording and in the known ones is compared."""
    random = np.random.default_rng(4)
    known = random.normal(size=(40_000, freedom + 1)).var(axis=1, ddof=1)
    recorded = (random.normal(size=(40_000, RECORDED)) ** 2).mean(axis=1)
    if_all_were_known = stats.chi2.ppf(confidence, RECORDED) / RECORDED
    limit = if_all_were_known * times_for_few(freedom, confidence) * known
    assert np.mean(recorded > limit) == pytest.approx(1 - confidence, abs=0.004)


def test_many_contacts_need_no_more() -> None:
    assert times_for_few(1_000_000, 0.95) == pytest.approx(1.0, abs=1e-4)
