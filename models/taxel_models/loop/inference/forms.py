"""Forms ready to be weighed: regressors as bins, scaled and whitened."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from taxel.channels import CHANNELS
from taxel_models.loop.basis import Floats
from taxel_models.loop.effects.effect import Candidate, about_mean
from taxel_models.loop.inference.products import Design
from taxel_models.loop.inference.whitening import Whitening

_HAS_MEAN = 0.02
"""A regressor's squared mean over its mean square, from where on the form less its mean is another one."""


@dataclass(frozen=True)
class WhitenedForm:
    """A form with its whitened regressors.

    Attributes:
        candidate: the form.
        design: its regressors, each divided by its unit and whitened.
        unit: (21, k) what makes a weight of 1 change a channel by its residual's standard deviation.
    """

    candidate: Candidate
    design: Design
    unit: Floats

    @property
    def size(self) -> int:
        """k."""
        return int(self.unit.shape[1])

    @property
    def freedom(self) -> int:
        """How many figures it can fit; a cause is not simpler because it shows in fewer channels."""
        fitting = self.candidate.fitting
        if fitting.fixed:
            return max(1, fitting.beforehand)
        weights = self.size if fitting.pooled else self.size * len(CHANNELS)
        return weights + fitting.beforehand

    def weights(self, scaled: Floats) -> Floats:
        """(21, k) weights of the candidate's own regressors."""
        return scaled / self.unit


def prepared(candidate: Candidate, whitening: Whitening) -> Iterator[WhitenedForm]:
    """A form, and the same less its mean where that makes a difference.

    A channel that the regressors do not move has no weights.
    """
    means = whitening.bins.of_basis(candidate.basis)
    yield _prepared(candidate, means, whitening)
    fitting = candidate.fitting
    average = means.mean(axis=1)
    square = (means**2).mean(axis=1)
    if fitting.fixed or candidate.again is None or not candidate.mean_absorbed:
        return
    if (average**2 > _HAS_MEAN * np.maximum(square, 1e-12)).any():
        yield _prepared(about_mean(candidate, average), means - average[:, None, :], whitening)


def prepared_as_it_is(candidate: Candidate, whitening: Whitening) -> WhitenedForm:
    """A form, whatever its mean is."""
    return _prepared(candidate, whitening.bins.of_basis(candidate.basis), whitening)


def _prepared(candidate: Candidate, means: Floats, whitening: Whitening) -> WhitenedForm:
    fitting, channels = candidate.fitting, len(CHANNELS)
    size = np.broadcast_to(np.sqrt((means**2).mean(axis=1)), (channels, means.shape[2]))
    relative = size / whitening.scale[:, None]
    if fitting.fixed:
        unit = np.ones_like(relative)
    elif fitting.pooled:
        allowed = np.ones(channels, bool) if fitting.allowed is None else fitting.allowed
        usual = np.sqrt((relative[allowed] ** 2).mean(axis=0))
        unit = np.broadcast_to(usual, relative.shape)
    else:
        unit = relative
    unit = np.where(unit > 1e-9, unit, np.inf)
    if fitting.prior is not None:
        unit = unit / fitting.prior
    if fitting.fixed or fitting.pooled:
        white = whitening(means / unit[:1][:, None, :])
    else:
        white = whitening(means / unit[:, None, :])
    return WhitenedForm(candidate, Design(white, whitening.bins.fold), unit)
