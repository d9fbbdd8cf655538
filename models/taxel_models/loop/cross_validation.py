"""Cross-validation: how well a candidate, or chance, explains the residual of held-out blocks."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from taxel.channels import ELECTRODE_COLUMNS
from taxel_models.evaluation.standard_error import corrected_standard_error
from taxel_models.loop.basis import Floats
from taxel_models.loop.effects.effect import Candidate
from taxel_models.loop.statistics import SufficientStatistics

FORCE_BINS: Final = 8
MOST_ROW_WEIGHT: Final = 4.0
"""A bin of rows counts at most so many times more, or less, than the mean."""

LEANS: Final = 4.0
"""One of two tests must pass; the p-value of the other one may be so many times as large."""

HUBER: Final = 2.0
"""A residual beyond so many times its bin's root mean square counts linearly, not squared."""


@dataclass(frozen=True)
class Score:
    """What one candidate explains in cross-validation.

    Attributes:
        candidate: the form of an effect.
        statistics: the statistics of its regressors with the residual.
        strength: (21,) F of each channel's weights.
        share: the share of the residual's energy that it explains over all channels; rows are weighted.
        fold_share: (folds,) the share that it explains in each fold.
        channel_share: (folds, 21) the share of each channel's energy that it explains in each fold.
    """

    candidate: Candidate
    statistics: SufficientStatistics
    strength: Floats
    share: float
    fold_share: Floats
    channel_share: Floats

    @property
    def channels(self) -> NDArray[np.bool_]:
        """(21,) channels that it may change."""
        return self.strength > 1.0

    @property
    def t_test(self) -> float:
        """One-sided p of the corrected resampled t-test over the folds (Nadeau and Bengio 2003)."""
        return difference_test(self.fold_share)[1]

    @property
    def repeats(self) -> float:
        """The smaller p-value of two tests, or a quarter of the larger one if that is more.

        The first test counts all channels alike. The second weighs channels by what the other folds show,
        because noise of the other channels would hide an effect of a few. A fold has no influence on its
        own weights, so under chance its share is as likely below 0 as above. One test must pass, and the
        other must tend the same way. An effect with the same weights for all channels has only the first.
        """
        if self.candidate.fitting.pooled or self.candidate.moves:
            return self.t_test
        by_fold = np.empty_like(self.fold_share)
        for fold in range(len(by_fold)):
            others = np.delete(self.channel_share, fold, axis=0).mean(axis=0)
            counts = np.maximum(others, 0.0)
            by_fold[fold] = counts @ self.channel_share[fold] / max(float(counts.sum()), 1e-12)
        less, greater = sorted((self.t_test, difference_test(by_fold)[1]))
        return max(less, greater / LEANS)

    def against(self, other: "Score") -> tuple[float, float]:
        """t and one-sided p of the same test: whether another explains more than this."""
        return difference_test(other.fold_share - self.fold_share)

    def unlikeness(self, scale: Floats) -> float:
        """Standard deviation of the electrodes' weights, relative to their mean.

        The other two channels have other units and other causes.

        Args:
            scale: (21,) what an error of each channel counts, 1/counts².
        """
        weights = self.statistics.weights(scale)[ELECTRODE_COLUMNS]
        mean = weights.mean(axis=0)
        deviation = np.sqrt(((weights - mean) ** 2).sum(axis=1).mean())
        return float(deviation / max(float(np.linalg.norm(mean)), 1e-12))

    def contradicts(self, scale: Floats) -> bool:
        """Whether its weights differ more than its cause allows.

        Args:
            scale: (21,) what an error of each channel counts, 1/counts².
        """
        return self.candidate.alike is not None and self.unlikeness(scale) > self.candidate.alike

    @property
    def freedom(self) -> int:
        """The number of its parameters: the form's and the fitted ones."""
        fitting, size = self.candidate.fitting, self.candidate.basis.size
        if fitting.fixed:
            size = 0
        elif not fitting.pooled:
            size *= len(self.strength)
        return size + len(self.candidate.form_parameters)


def difference_test(by_fold: Floats) -> tuple[float, float]:
    """t and one-sided p of the corrected resampled t-test: whether the mean over folds is above 0."""
    folds = len(by_fold)
    # Each fold is tested on one part and fitted to the others.
    t = float(by_fold.mean()) / max(corrected_standard_error(by_fold, 1.0 / max(folds - 1, 1)), 1e-12)
    return t, float(stats.t.sf(t, folds - 1))


def scale_of(residual: Floats) -> Floats:
    """(21,) weights that make every channel's mean squared residual 1."""
    return np.asarray(1.0 / np.maximum((residual**2).mean(axis=0), 1e-9))


def row_weights_of(residual: Floats, pressed: Floats, fit: NDArray[np.bool_]) -> Floats:
    """(n,) how much each row counts: less where the residual scatters more.

    A model errs most where it is pressed hardest, and a few contacts would drown the rest. Rows are
    binned by force; a bin counts by its inverse mean squared residual, within limits, and a row far
    outside its bin counts less (Huber 1964).
    """
    size = (residual**2 * scale_of(residual[fit])).mean(axis=1)
    edges = np.unique(np.quantile(pressed[fit], np.linspace(0, 1, FORCE_BINS + 1)[1:-1]))
    bins = np.searchsorted(edges, pressed)
    mean_squares = np.array([_mean(size[fit & (bins == number)]) for number in range(len(edges) + 1)])
    mean_squares = np.clip(mean_squares, MOST_ROW_WEIGHT**-1, MOST_ROW_WEIGHT)[bins]
    row_weights = np.minimum(1.0, HUBER * np.sqrt(mean_squares / np.maximum(size, 1e-12))) / mean_squares
    return np.asarray(row_weights / row_weights[fit].mean())


def absolute_of(residual: Floats, fit: NDArray[np.bool_]) -> Floats:
    """(n,) weights that make squared errors count about as absolute ones do: 1 over the row's size.

    The mean absolute error tells what an effect is worth to a user: a few contacts that the model predicts
    badly do not dominate it.
    """
    size = np.sqrt((residual**2 * scale_of(residual[fit])).mean(axis=1))
    return np.asarray(1.0 / np.maximum(size, np.quantile(size[fit], 0.1)))


def _mean(values: Floats) -> float:
    return float(values.mean()) if len(values) else 1.0


def cross_validate(candidate: Candidate, statistics: SufficientStatistics, scale: Floats) -> Score:
    """Cross-validate one candidate."""
    gains = statistics.gains(scale)
    energy = statistics.energy * scale
    by_fold = np.array([energy[statistics.fold == fold].sum(axis=0) for fold in range(statistics.folds)])
    return Score(
        candidate,
        statistics,
        statistics.strength(scale),
        float(gains.sum() / by_fold.sum()),
        gains.sum(axis=1) / by_fold.sum(axis=1),
        gains / np.maximum(by_fold, 1e-12),
    )


def stands_out(statistics: SufficientStatistics, scale: Floats, signs: Floats) -> Floats:
    """(1 + draws,) how far a candidate stands out from chance: first of the data, then of each draw.

    Two figures count, the sum of the channels' strengths and the strongest channel's. Their unit is their
    standard deviation over draws with a random sign for every block's residual. A block keeps its
    correlations (wild cluster bootstrap; Cameron, Gelbach and Miller 2008).
    """
    every = np.vstack([np.ones((1, signs.shape[1])), signs])
    strengths = np.log1p(statistics.strengths(scale, every))
    both = np.stack([strengths.sum(axis=1), strengths.max(axis=1)])
    usual, deviation = both[:, 1:].mean(axis=1), both[:, 1:].std(axis=1) + 1e-9
    return np.asarray(((both - usual[:, None]) / deviation[:, None]).max(axis=0))


def worth(score: Score, alike: SufficientStatistics, scale: Floats, first: Floats) -> Floats:
    """(21,) share of each channel's first error that it takes away, about as absolute errors count.

    Args:
        alike: the candidate's statistics with rows counted by `absolute_of`.
        first: (21,) the channels' residual energy before anything was explained, counted so, and
            summed over the same rows.
    """
    gains = score.statistics.gains(scale, tested=alike).sum(axis=0) / scale
    return np.asarray(gains / np.maximum(first, 1e-9))


def random_signs(draws: int, blocks: int, seed: int) -> Floats:
    """(draws, blocks) of +1 and -1."""
    return np.random.default_rng(seed).choice([-1.0, 1.0], size=(draws, blocks))
