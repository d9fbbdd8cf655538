"""What an effect takes off the error in counts, against plain refits; and a model's own noise."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from taxel.channels import ELECTRODE_COLUMNS
from taxel_models.loop.blocks import cut
from taxel_models.loop.effects.effect import Fitting
from taxel_models.loop.effects.gain import Gain
from taxel_models.loop.inference.constants import DECLARED
from taxel_models.loop.inference.evidence import Weighed, posterior_weights, weigh
from taxel_models.loop.inference.products import Base, Design, Products
from taxel_models.loop.inference.scoring import Scoring
from taxel_models.loop.inference.whitening import Bins, NoiseShape, Whitening
from taxel_models.loop.inference.worth import held_out_error
from taxel_models.loop.observations import Observations, gather
from taxel_models.loop.status import silent
from taxel_models.recordings import Recording

EVERY = Weighed(1.0, 0.5, np.ones(21), np.ones(21))
GAIN = 0.3


@pytest.mark.parametrize("not_served", [0, 1])
def test_errors_are_those_of_plain_refits(draw: Callable[..., Products], not_served: int) -> None:
    products = draw(3, base_size=2, size=2)
    base = replace(products.base, not_served=not_served)
    before, after = held_out_error(
        replace(products, base=base), Fitting(), EVERY, lambda white: 2.0 * white
    )
    fold, precision = base.target.fold, np.array([4.0, 4.0, 0.5**-2, 0.5**-2])
    for channel in range(21):
        regressors = np.hstack([base.design.values[channel], products.design.values[channel]])
        target = base.target.values[channel, :, 0]
        for used, found in ((2, before), (4, after)):
            own, left = regressors[:, :used], np.empty(base.bins)
            for number in np.unique(fold):
                fit, held = fold != number, fold == number
                gram = own[fit].T @ own[fit] + np.diag(precision[:used])
                weights = np.linalg.solve(gram, own[fit].T @ target[fit])
                weights[:not_served] = 0.0
                left[held] = target[held] - own[held] @ weights
            assert found[channel] == pytest.approx(4.0 * (left**2).sum())


@pytest.mark.parametrize("robust", [1e9, 1.0])
def test_errors_have_their_colour_again(smooth: Any, recording: Recording, robust: float) -> None:
    observations = gather(smooth, [recording])
    bins = Bins.of(cut(observations, seed=0), DECLARED.bin_s)
    constants = replace(DECLARED, robust=robust)
    whitening = Whitening(bins, NoiseShape.usual(), observations.residual, constants)
    means = bins.means(observations.residual.T[:, :, None])
    counted = np.sqrt(whitening.row_weights(len(observations))[bins.order[bins.starts]]).T
    np.testing.assert_allclose(whitening.coloured(whitening(means)[:, :, 0]), means[:, :, 0] * counted)
    assert (counted < 1.0).any() == (robust == 1.0)


def with_noise(smooth: Any, recording: Recording) -> Observations:
    """All signals are larger by a gain, and the model's predictions have fast noise of their own."""
    seen = gather(smooth, [recording])
    about = seen.predicted - seen.predicted.mean(axis=0)
    measured = seen.measured + GAIN * about
    noise = np.random.default_rng(5).normal(size=about.shape) * about.std(axis=0)
    return replace(seen, measured=measured, predicted=seen.predicted + noise, base=seen.predicted + noise)


def test_a_gain_is_found_beside_the_models_own_noise(smooth: Any, recording: Recording) -> None:
    """The noise is in the prediction and, with the other sign, in the residual."""
    observations = with_noise(smooth, recording)
    blocks = cut(observations, seed=0)
    scoring = Scoring(observations, blocks, [Gain()], None, DECLARED, silent)
    form = next(form for form in scoring.forms_of(Gain()) if form.candidate.form == "by channel")
    base = scoring.base([])
    fold, none = base.design.fold, np.empty((21, 0))
    without = Base(base.target, Design(base.design.values[:, :, :0], fold), none, base.quantum)

    def found(base: Base) -> float:
        products = Products.of(base, form.design)
        _, scaled = posterior_weights(products, Fitting(), weigh(products, Fitting(), DECLARED))
        return float(np.median(form.weights(scaled)[ELECTRODE_COLUMNS, 0]))

    assert found(without) < 0.5 * GAIN
    assert found(base) == pytest.approx(GAIN, rel=0.25)
