"""Small conjugate models: whitened regressors and a residual, of every channel."""

from collections.abc import Callable

import numpy as np
import pytest

from taxel_models.loop.inference.products import Base, Design, Products

CHANNELS = 21


def drawn(
    seed: int, *, bins: int = 40, base_size: int = 1, size: int = 2, folds: int = 4, quantum: float = 0.0
) -> Products:
    """Regressors beside a base, and a residual that has some of each."""
    random = np.random.default_rng(seed)
    fold = np.sort(np.arange(bins) % folds)
    base_values = random.normal(size=(CHANNELS, bins, base_size))
    values = random.normal(size=(CHANNELS, bins, size))
    if base_size:
        values += 0.5 * base_values[:, :, :1]
    weights = random.normal(size=(CHANNELS, size)) * 0.4
    target = random.normal(size=(CHANNELS, bins)) + np.einsum("cbk,ck->cb", values, weights)
    target += base_values.sum(axis=2)
    precision = np.full((CHANNELS, base_size), 4.0)
    base = Base(
        Design(target[:, :, None], fold),
        Design(base_values, fold),
        precision,
        np.full(CHANNELS, quantum),
    )
    return Products.of(base, Design(values, fold))


@pytest.fixture(scope="session")
def draw() -> Callable[..., Products]:
    return drawn
