"""The precision of the channels' errors: how much each tells of the others (Whittaker 1990).

Few contacts tell little of a covariance of 21 channels. It is shrunk by as much as foretells other contacts
best, and the contacts that it is from are judged without themselves.
"""

from collections.abc import Callable, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from taxel_models.loop.basis import Floats
from taxel_models.loop.inference.correlated_channels import root_of

OWN_NOISE: Final = (0.001, 0.003, 0.01, 0.03, 0.1, 0.3, 1.0)
"""Shares of its variance that are added to each channel's, so that a covariance of few contacts is not
taken at its word; the share that foretells held-out parts best is taken."""

LEAST_RESIDUAL: Final = 0.3
"""Counts: a channel that errs less is taken to err so much."""

PARTS: Final = 10
"""Parts of the held-out recordings: each is judged by the precision of the others."""

FEWEST_PARTS: Final = 5


def precision_of(residual: Floats, own_noise: float) -> Floats:
    """(21, 21) inverse of the covariance of a residual (n, 21), counts⁻².

    Args:
        own_noise: share of its variance that is added to each channel's.
    """
    residual = residual - residual.mean(axis=0)
    size = np.maximum(residual.std(axis=0), LEAST_RESIDUAL)
    scaled = residual / size
    correlation = scaled.T @ scaled / len(scaled) + own_noise * np.eye(len(size))
    return np.asarray(np.linalg.inv(correlation) / np.outer(size, size))


def likeliest_own_noise(residual: Floats, parts: Sequence[NDArray[np.bool_]]) -> float:
    """The share with which the other parts' covariance makes each part of a residual (n, 21) likeliest."""
    likelihood = np.zeros(len(OWN_NOISE))
    for part in parts:
        others, own = residual[~part], residual[part] - residual[~part].mean(axis=0)
        for place, share in enumerate(OWN_NOISE):
            precision = precision_of(others, share)
            size = 0.5 * len(own) * float(np.linalg.slogdet(precision)[1])
            likelihood[place] += size - 0.5 * float(((own @ precision) * own).sum())
    return OWN_NOISE[int(likelihood.argmax())]


def parts_of(unit: NDArray[np.int64], seed: int = 0) -> list[NDArray[np.bool_]]:
    """(n,) each; rows of one unit (n,) stay together."""
    own = np.unique(unit)
    order = np.random.default_rng(seed).permutation(own)
    return [np.isin(unit, part) for part in np.array_split(order, min(PARTS, len(own)))]


def without_itself(
    parts: Sequence[NDArray[np.bool_]], precisions: Sequence[Floats]
) -> Callable[[Floats], Floats]:
    """What whitens a residual (n, 21) of rows in parts, each with a precision that it has no part in."""
    roots = [root_of(precision) for precision in precisions]

    def whiten(other: Floats) -> Floats:
        errors = np.empty_like(other)
        for part, root in zip(parts, roots, strict=True):
            errors[part] = other[part] @ root.T
        return errors

    return whiten
