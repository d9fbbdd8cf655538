"""A gain is told from counts that are added with the same course, also where these end at a limit."""

from typing import Any

import numpy as np
import pytest

from taxel.channels import COUNTS_MAX
from taxel_models.loop.basis import Own, Shared
from taxel_models.loop.blocks import cut
from taxel_models.loop.effects.effect import Candidate
from taxel_models.loop.inference.constants import DECLARED
from taxel_models.loop.inference.shape import is_added
from taxel_models.loop.inference.whitening import Bins
from taxel_models.loop.observations import Observations

CHANNEL = 7


def judged(
    observations: Observations, course: Any, change: Any, *, own: bool = False, always: bool = False
) -> bool:
    """Of a tared channel: what it reads above rest, with noise and a change; pressed or not, or always."""
    random = np.random.default_rng(1)
    rows = len(observations)
    force = np.repeat(random.uniform(60.0 if always else 20.0, 120.0, rows // 150 + 1), 150)[:rows]
    contact = force if always else (np.arange(rows) // 150) % 2 * force
    signal = np.tile(contact[:, None], (1, 21))
    time = np.linspace(0.0, 1.0, rows)
    counts = signal[:, CHANNEL] + 3.0 * random.normal(size=rows) + change(signal[:, CHANNEL], time)
    measured = signal.copy()
    measured[:, CHANNEL] = np.clip(np.rint(counts), 0, COUNTS_MAX)
    features = np.column_stack([np.ones(rows), *([time] if course == "ageing" else [])])
    basis = Own(np.ones((rows, 21, 1), np.float32)) if own else Shared(features, signal)
    bins = Bins.of(cut(observations, seed=0), DECLARED.bin_s)
    return is_added(Candidate("gain", course, basis), CHANNEL, measured, measured - signal, bins)


@pytest.mark.parametrize("course", ["constant", "ageing"])
@pytest.mark.parametrize("share", [-0.7, -0.2, 0.3])
def test_a_gain_is_none(observations: Observations, course: str, share: float) -> None:
    def change(signal: Any, time: Any) -> Any:
        return share * signal * (time if course == "ageing" else 1.0)

    assert not judged(observations, course, change)


@pytest.mark.parametrize("course", ["constant", "ageing"])
@pytest.mark.parametrize("counts", [-40.0, -15.0, 25.0])
def test_counts_are_whether_they_end_at_a_limit_or_not(
    observations: Observations, course: str, counts: float
) -> None:
    def change(_: Any, time: Any) -> Any:
        return counts * (time if course == "ageing" else np.ones_like(time))

    assert judged(observations, course, change)


def test_a_gain_whose_mean_the_model_absorbed_is_none(observations: Observations) -> None:
    assert not judged(observations, "constant", lambda signal, _: 0.3 * (signal - signal.mean()))


def test_a_gain_that_fades_is_none_where_a_constant_of_the_model_stands_beside_it(
    observations: Observations,
) -> None:
    """A finger that is always pressed: the constant is no factor of a signal that is never 0."""

    def change(signal: Any, time: Any) -> Any:
        faded = -0.3 * signal * -np.expm1(-4.0 * time)
        return faded - faded.mean()

    assert not judged(observations, "ageing", change, always=True)


@pytest.mark.parametrize("always", [False, True])
def test_a_constant_is_no_gain_that_ages(observations: Observations, always: bool) -> None:
    assert judged(observations, "ageing", lambda _, time: -15.0 * np.ones_like(time), always=always)


def test_a_form_that_follows_no_signal_is_none(observations: Observations) -> None:
    assert not judged(observations, "constant", lambda _, time: 25.0 * np.ones_like(time), own=True)
