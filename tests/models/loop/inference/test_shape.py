"""A gain or a leak is told from counts that are added, also where these end at a limit, and from a bend."""

from typing import Any, NamedTuple

import numpy as np
import pytest

from taxel.channels import COUNTS_MAX
from taxel.corrections import saturation_design
from taxel_models.loop.basis import Own, Shared
from taxel_models.loop.blocks import cut
from taxel_models.loop.effects.effect import Candidate
from taxel_models.loop.effects.saturation import QUANTILES
from taxel_models.loop.inference.constants import DECLARED
from taxel_models.loop.inference.shape import Shape
from taxel_models.loop.inference.whitening import Bins
from taxel_models.loop.observations import Observations

CHANNEL = 7


class Tared(NamedTuple):
    """A tared channel that changes, and what may be the cause.

    Attributes:
        measured: (n, 21) counts.
        left: (n, 21) what the model does not predict of them, counts.
        signal: (n, 21) what it predicts.
    """

    measured: Any
    left: Any
    signal: Any
    candidate: Candidate
    bins: Bins

    @property
    def _shape(self) -> Shape:
        return Shape.of(self.candidate, CHANNEL, self.measured, self.left, self.bins)

    @property
    def is_added(self) -> bool:
        return self._shape.is_added

    @property
    def is_bent(self) -> bool:
        signal = self.signal[:, [CHANNEL]]
        levels = np.quantile(signal, QUANTILES)
        return self._shape.is_bent(
            saturation_design(signal, level[None])[self.bins.order, 0] for level in levels
        )


def tared(
    observations: Observations, course: Any, change: Any, *, leak: bool = False, always: bool = False
) -> Tared:
    """What a channel reads above rest, with noise and a change; pressed or not, or always."""
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
    other = np.tile((contact * random.uniform(0.5, 1.0, rows))[:, None, None], (1, 21, 1))
    basis = Own(other.astype(np.float32)) if leak else Shared(features, signal)
    bins = Bins.of(cut(observations, seed=0), DECLARED.bin_s)
    return Tared(measured, measured - signal, signal, Candidate("gain", course, basis), bins)


@pytest.mark.parametrize("course", ["constant", "ageing"])
@pytest.mark.parametrize("share", [-0.7, -0.2, 0.3])
def test_a_gain_is_none(observations: Observations, course: str, share: float) -> None:
    def change(signal: Any, time: Any) -> Any:
        return share * signal * (time if course == "ageing" else 1.0)

    found = tared(observations, course, change)
    assert not found.is_added
    assert not found.is_bent


@pytest.mark.parametrize("course", ["constant", "ageing"])
@pytest.mark.parametrize("counts", [-40.0, -15.0, 25.0])
def test_counts_are_whether_they_end_at_a_limit_or_not(
    observations: Observations, course: str, counts: float
) -> None:
    def change(_: Any, time: Any) -> Any:
        return counts * (time if course == "ageing" else np.ones_like(time))

    assert tared(observations, course, change).is_added


def test_a_gain_whose_mean_the_model_absorbed_is_none(observations: Observations) -> None:
    found = tared(observations, "constant", lambda signal, _: 0.3 * (signal - signal.mean()))
    assert not found.is_added
    assert not found.is_bent


def test_a_gain_that_fades_is_none_where_a_constant_of_the_model_stands_beside_it(
    observations: Observations,
) -> None:
    """A finger that is always pressed: the constant is no factor of a signal that is never 0."""

    def change(signal: Any, time: Any) -> Any:
        faded = -0.3 * signal * -np.expm1(-4.0 * time)
        return faded - faded.mean()

    assert not tared(observations, "ageing", change, always=True).is_added


@pytest.mark.parametrize("always", [False, True])
def test_a_constant_is_no_gain_that_ages(observations: Observations, always: bool) -> None:
    found = tared(observations, "ageing", lambda _, time: -15.0 * np.ones_like(time), always=always)
    assert found.is_added


def test_counts_that_are_taken_away_are_no_leak(observations: Observations) -> None:
    assert tared(observations, "constant", lambda _, time: -15.0 * np.ones_like(time), leak=True).is_added
    for change in (lambda signal, _: -0.3 * signal, lambda signal, _: 0.3 * signal):
        assert not tared(observations, "constant", change, leak=True).is_added


@pytest.mark.parametrize("course", ["constant", "ageing"])
@pytest.mark.parametrize(
    "bend", [lambda s: np.minimum(s, 70.0), lambda s: 100.0 * np.tanh(s / 100.0)], ids=["cut off", "bent"]
)
def test_a_channel_that_saturates_loses_no_share_of_a_signal(
    observations: Observations, course: str, bend: Any
) -> None:
    assert tared(observations, course, lambda signal, _: bend(signal) - signal).is_bent
    # A channel that gives ever more saturates in no way.
    assert not tared(observations, course, lambda signal, _: signal - bend(signal)).is_bent
