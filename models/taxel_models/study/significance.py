"""The corrected resampled paired t-test of Nadeau and Bengio (2003), with intervals and effect sizes."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import ArrayLike
from scipy import stats
from statsmodels.stats.multitest import multipletests

from taxel.errors import InvalidArgument
from taxel_models.evaluation.standard_error import corrected_standard_error

CONFIDENCE: Final = 0.95
"""Confidence level of the intervals."""


@dataclass(frozen=True)
class Comparison:
    """Whether the first has lower errors than the second, fold by fold.

    Attributes:
        folds: number of pairs.
        difference: mean of first minus second.
        low: lower limit of the two-sided 95 % confidence interval of the difference.
        high: upper limit.
        t: the test statistic; None if all folds differ by the same amount.
        p: one-sided probability of so low a t if there is no difference.
        p_holm: `p` corrected for all comparisons made with it, after Holm 1979.
        effect: the difference over its standard deviation between folds (Cohen's d of paired values);
            None if all folds differ by the same amount.
        relative: the difference over the second's mean.
    """

    folds: int
    difference: float
    low: float
    high: float
    t: float | None
    p: float
    p_holm: float
    effect: float | None
    relative: float


def compare(first: ArrayLike, second: ArrayLike, test_ratio: float) -> Comparison:
    """Test whether errors are lower; `p_holm` is still `p`.

    t = mean(d) / sqrt((1/J + n2/n1) var(d)), with J - 1 degrees of freedom, where d are the J
    differences, var their unbiased variance, n1 training and n2 test windows of a fold.

    Args:
        first: (J,) errors, one a fold.
        second: (J,) errors of the other on the same folds.
        test_ratio: n2/n1.

    Raises:
        InvalidArgument: not two or more pairs.
    """
    errors, others = np.asarray(first, np.float64), np.asarray(second, np.float64)
    if errors.shape != others.shape or errors.ndim != 1 or len(errors) < 2:
        raise InvalidArgument(f"errors {errors.shape} and {others.shape}: expected (J,) each, J > 1")
    differences = errors - others
    folds, mean, deviation = len(errors), float(differences.mean()), float(differences.std(ddof=1))
    error = corrected_standard_error(differences, test_ratio)
    reach = float(stats.t.ppf((1 + CONFIDENCE) / 2, folds - 1)) * error
    t = mean / error if error > 0 else None
    p = float(stats.t.cdf(t, folds - 1)) if t is not None else _certain(mean)
    return Comparison(
        folds=folds,
        difference=mean,
        low=mean - reach,
        high=mean + reach,
        t=t,
        p=p,
        p_holm=p,
        effect=mean / deviation if deviation > 0 else None,
        relative=mean / float(others.mean()) if others.any() else 0.0,
    )


def _certain(mean: float) -> float:
    """The limit of p as the variance goes to 0."""
    return 0.5 if mean == 0 else float(mean > 0)


def corrected(comparisons: Sequence[Comparison]) -> list[Comparison]:
    """The same comparisons, with `p_holm` for their number."""
    if not comparisons:
        return []
    p_values = multipletests([comparison.p for comparison in comparisons], method="holm")[1]
    return [
        replace(comparison, p_holm=float(p)) for comparison, p in zip(comparisons, p_values, strict=True)
    ]
