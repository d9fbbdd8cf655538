"""A change of few channels and the named effects in them are inferred together, as least squares does."""

from typing import Any

import numpy as np
import pytest

from taxel.channels import CHANNELS
from taxel_models.loop.basis import Floats, Own, Shared
from taxel_models.loop.blocks import cut
from taxel_models.loop.effects.effect import Candidate, Fitting
from taxel_models.loop.inference.constants import DECLARED
from taxel_models.loop.inference.evidence import Bases
from taxel_models.loop.inference.few_channels_form import ChannelForms
from taxel_models.loop.inference.named_in_channels import NamedInChannels
from taxel_models.loop.inference.products import Base, Design
from taxel_models.loop.inference.whitening import Bins, NoiseShape, Whitening
from taxel_models.loop.observations import Observations

CHANGED = [4, 9]
"""Channels of the change; a named effect has the first of them and others, but not the second."""


class Ground:
    """Whitened channels with a target, a named effect and a change of two channels."""

    def __init__(self, observations: Observations, seed: int, named: bool = True) -> None:
        random = np.random.default_rng(seed)
        rows, channels = len(observations), len(CHANNELS)
        self.bins = Bins.of(cut(observations, seed=0), DECLARED.bin_s)
        self.noise = random.uniform(0.5, 2.0, channels)
        residual = random.normal(size=(rows, channels)) + 0.5
        whitening = Whitening(self.bins, NoiseShape.usual(), residual, DECLARED)
        mixing = np.eye(channels) + 0.1 * random.normal(size=(channels, channels))
        self.ones = Design(whitening.ones, self.bins.fold)
        self.target = whitening(self.bins.means(residual.T[:, :, None]))
        slow = np.cumsum(random.normal(size=(rows, 3)), axis=0)
        effect = Candidate("creep", "by force", Shared(slow[:, :2]), fitting=Fitting())
        own = (slow[:, 2:, None] + slow[:, :1, None] + random.normal(size=(rows, channels, 1))).astype("f4")
        change = Candidate("gain", "by channel", Own(own), fitting=Fitting())
        self.effects = ChannelForms([effect], mixing, whitening)
        self.changes = ChannelForms([change], mixing, whitening)
        has = np.arange(channels) < CHANGED[1]
        one = [has] if named else []
        self.beside = NamedInChannels(one, self.effects, self.target, self.bases)

    def bases(self, target: Floats) -> Bases:
        """Beside a constant of each whitened channel, whose noise is known."""
        empty = np.empty((len(CHANNELS), 0))
        nothing = Design(empty[:, None, :].repeat(len(self.bins), axis=1), self.bins.fold)
        base = Base(Design(target, self.bins.fold), nothing, empty, np.zeros(len(CHANNELS)), self.noise)
        return Bases.of(base, self.ones, DECLARED)


def least_squares(columns: Floats, target: Floats) -> Floats:
    """Of regressors (n, k)."""
    return np.asarray(np.linalg.lstsq(columns, target, rcond=None)[0])


@pytest.mark.parametrize("seed", range(3))
def test_weights_are_those_of_one_regression_on_all_of_them(observations: Observations, seed: int) -> None:
    """The root of the noise weighs each whitened channel; each has a constant of its own."""
    ground = Ground(observations, seed)
    channels, bins = len(CHANNELS), len(ground.bins)
    root = np.sqrt(ground.noise)[:, None, None]

    def flat(values: Floats) -> Floats:
        return np.asarray((values / root).reshape(channels * bins, -1))

    constants = np.zeros((channels, bins, channels))
    constants[range(channels), :, range(channels)] = ground.ones.values[:, :, 0]
    change = ground.changes.design(dict.fromkeys(CHANGED, 0))
    named = ground.effects.design({CHANGED[0]: 0})
    columns = np.hstack([flat(values) for values in (change.values, named.values, constants)])
    expected = least_squares(columns, flat(ground.target)[:, 0])[: len(CHANGED)]

    left = ground.beside.bases(CHANGED).beside.target
    alone = np.hstack([flat(ground.beside.without(change, CHANGED).values), flat(constants)])
    found = least_squares(alone, flat(left.values)[:, 0])[: len(CHANGED)]
    np.testing.assert_allclose(found, expected, rtol=1e-6)


@pytest.mark.parametrize(("named", "channels"), [(False, CHANGED), (True, CHANGED[1:])])
def test_where_no_named_effect_is_nothing_is_taken_out(
    observations: Observations, named: bool, channels: list[int]
) -> None:
    ground = Ground(observations, 0, named)
    design = ground.changes.design(dict.fromkeys(channels, 0))
    assert ground.beside.without(design, channels) is design
    np.testing.assert_array_equal(ground.beside.bases(channels).plain.target.values, ground.target)


def test_a_regressor_that_is_there_twice_is_taken_out_once(observations: Observations) -> None:
    ground = Ground(observations, 0)
    effect: Any = ground.effects.candidates[0]
    twice = ChannelForms([effect, effect], np.eye(len(CHANNELS)), ground.effects._whitening)
    every = np.ones(len(CHANNELS), bool)
    once = NamedInChannels([every], twice, ground.target, ground.bases)
    again = NamedInChannels([every, every], twice, ground.target, ground.bases)
    design = ground.changes.design(dict.fromkeys(CHANGED, 0))
    found, expected = (one.without(design, CHANGED).values for one in (again, once))
    np.testing.assert_allclose(found, expected, atol=1e-9)
