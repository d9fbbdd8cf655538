"""Correlations between the weights of all named effects: what the recording can tell only together."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from taxel.channels import CHANNELS
from taxel_models.loop.basis import Floats
from taxel_models.loop.findings import ParameterCorrelation
from taxel_models.loop.inference.products import inverse_of
from taxel_models.loop.inference.score import UNSHRUNK, Taken


def parameter_correlation(taken: Sequence[Taken], noise: Floats) -> ParameterCorrelation | None:
    """Of the least squares weights; each value of the channel in which it is largest.

    Args:
        taken: the named effects.
        noise: (21,) mean square of what they leave, whitened.

    Returns:
        None where fewer than two weights are fitted.
    """
    fitted = [
        each
        for each in taken
        if not (each.form.candidate.fitting.fixed or each.form.candidate.fitting.few_channels)
    ]
    names = [f"{each.name}: {name}" for each in fitted for name in each.form.candidate.weight_names]
    if len(names) < 2:
        return None
    values = np.concatenate([each.form.design.values for each in fitted], axis=2)
    sizes = [each.form.size for each in fitted]
    pooled = np.repeat([each.form.candidate.fitting.pooled for each in fitted], sizes)
    changes = np.repeat(np.array([each.weighed.changes for each in fitted]), sizes, axis=0).T
    gram = values.transpose(0, 2, 1) @ values / noise[:, None, None]
    gram *= changes[:, :, None] & changes[:, None, :]
    found = _correlations(gram, pooled)
    largest = np.abs(found).argmax(axis=0)
    matrix = np.take_along_axis(found, largest[None], axis=0)[0]
    np.fill_diagonal(matrix, 1.0)
    rounded = tuple(tuple(round(float(value), 4) for value in row) for row in matrix)
    return ParameterCorrelation(parameters=tuple(names), matrix=rounded)


def _correlations(gram: Floats, pooled: NDArray[np.bool_]) -> Floats:
    """(21, k, k) for grams (21, k, k) over the noise; 0 for weights that a channel does not have.

    Some weights (k,) are common to all channels: their precision is the sum over the channels, each less
    what the channel's own weights take (the Schur complement).
    """
    common, own = np.flatnonzero(pooled), np.flatnonzero(np.logical_not(pooled))
    every = np.arange(len(CHANNELS))
    there = np.diagonal(gram, axis1=1, axis2=2) > 0
    precision = np.where(there, UNSHRUNK**-2, np.inf)
    within = inverse_of(gram[:, own][:, :, own], precision[:, own])
    between = within @ gram[:, own][:, :, common]
    covariance = np.zeros_like(gram)
    if len(common):
        left = gram[:, common][:, :, common] - gram[:, common][:, :, own] @ between
        shared = np.linalg.inv(left.sum(axis=0) + np.eye(len(common)) * UNSHRUNK**-2)
        covariance[np.ix_(every, common, common)] = shared
        across = -between @ shared
        covariance[np.ix_(every, own, common)] = across
        covariance[np.ix_(every, common, own)] = across.transpose(0, 2, 1)
        within = within - across @ between.transpose(0, 2, 1)
    covariance[np.ix_(every, own, own)] = within
    size = np.sqrt(np.maximum(np.diagonal(covariance, axis1=1, axis2=2), 0.0))
    scale = np.where(size > 0, size, np.inf)
    return np.asarray(covariance / scale[:, :, None] / scale[:, None, :])
