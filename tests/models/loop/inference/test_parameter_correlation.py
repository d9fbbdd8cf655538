"""Correlations between weights beside those of one large inverse."""

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np

from taxel.channels import CHANNELS
from taxel_models.loop.effects.effect import Fitting
from taxel_models.loop.inference.parameter_correlation import parameter_correlation
from taxel_models.loop.inference.products import Design


@dataclass
class Fitted:
    """As much of a named effect as the correlations need."""

    name: str
    form: Any
    weighed: Any


def fitted(name: str, values: np.ndarray, *, pooled: bool, changes: np.ndarray) -> Any:
    size = values.shape[2]
    names = tuple(f"w{place}" for place in range(size))
    fitting = Fitting(pooled=pooled)
    candidate = SimpleNamespace(fitting=fitting, weight_names=names)
    form = SimpleNamespace(
        candidate=candidate, design=Design(values, np.zeros(values.shape[1], int)), size=size
    )
    return Fitted(name, form, SimpleNamespace(changes=changes))


def test_correlations_are_those_of_the_whole_inverse() -> None:
    random = np.random.default_rng(0)
    channels, bins = len(CHANNELS), 60
    clock = np.linspace(-1.0, 1.0, bins)
    own = np.stack([random.normal(size=(channels, bins)), np.tile(clock, (channels, 1))], axis=2)
    common = (0.7 * clock + random.normal(size=(channels, bins)))[:, :, None]
    changes = np.arange(channels) % 3 != 0
    noise = random.uniform(0.5, 2.0, channels)
    effects = [
        fitted("creep", own, pooled=False, changes=changes),
        fitted("gain", common, pooled=True, changes=np.ones(channels, bool)),
    ]
    found = parameter_correlation(effects, noise)
    assert found is not None
    assert found.parameters == ("creep: w0", "creep: w1", "gain: w0")

    # All rows of all channels in one regression: two weights of each channel that has them, one of all.
    columns = np.zeros((channels, bins, 2 * channels + 1))
    for channel in np.flatnonzero(changes):
        columns[channel, :, 2 * channel : 2 * channel + 2] = own[channel]
    columns[:, :, -1] = common[:, :, 0]
    design = (columns / np.sqrt(noise)[:, None, None]).reshape(channels * bins, -1)
    there = np.flatnonzero((design**2).sum(axis=0) > 0)
    covariance = np.linalg.inv(design[:, there].T @ design[:, there])
    deviation = np.sqrt(np.diag(covariance))
    correlation = np.eye(2 * channels + 1)
    correlation[np.ix_(there, there)] = covariance / np.outer(deviation, deviation)
    expected = np.eye(3)
    for first, second in ((0, 1), (0, 2), (1, 2)):
        values = [
            correlation[places[first], places[second]]
            for places in ((2 * channel, 2 * channel + 1, 2 * channels) for channel in range(channels))
        ]
        expected[first, second] = expected[second, first] = max(values, key=abs)
    np.testing.assert_allclose(found.matrix, expected, atol=1e-4)


def test_one_weight_has_nothing_to_be_correlated_with() -> None:
    values = np.ones((len(CHANNELS), 5, 1))
    one = fitted("offset", values, pooled=False, changes=np.ones(len(CHANNELS), bool))
    assert parameter_correlation([one], np.ones(len(CHANNELS))) is None
