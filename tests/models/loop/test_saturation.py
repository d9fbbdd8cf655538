"""A saturation bends each channel at a level of its own."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from taxel.channels import CHANNELS
from taxel.corrections import saturation_design
from taxel.windows.history import TOUCH_N
from taxel_models.loop.effects.effect import Remaining
from taxel_models.loop.effects.saturation import QUANTILES, Saturation
from taxel_models.loop.observations import Observations, gather
from taxel_models.recordings import Recording

Make = Callable[..., Recording]


@pytest.fixture(scope="module")
def observations(smooth: Any, make: Make) -> Observations:
    return gather(smooth, [make(seed=3).ticks()])


def test_the_level_of_each_channel_is_found(observations: Observations) -> None:
    """Each channel loses a fourth of what its signal has beyond one of the quantiles."""
    touched = observations.pressed > TOUCH_N
    levels = np.quantile(np.abs(observations.signal[touched]), QUANTILES, axis=0)
    planted = levels[np.arange(len(CHANNELS)) % len(QUANTILES), np.arange(len(CHANNELS))]
    lost = 0.25 * saturation_design(observations.signal, planted)
    given = replace(observations, measured=observations.predicted + lost)
    rows = np.ones(len(given), bool)
    remaining = Remaining(given.residual, rows, np.ones(len(given)))
    own = list(Saturation().forms(given, remaining))[-1]
    assert (own.form, own.fitting.choices) == ("beyond each channel's own level", len(QUANTILES))
    weights = np.full((len(CHANNELS), 1), 0.25)
    (term,) = own.online(weights).terms
    np.testing.assert_array_equal(np.array(term.level), planted)
    np.testing.assert_allclose(own.basis.times(weights), lost, atol=1e-3)
