"""Bins are the means of their rows, and whitened noise has no correlation left."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from taxel_models.loop.basis import Own, Shared
from taxel_models.loop.blocks import Blocks
from taxel_models.loop.inference.constants import DECLARED
from taxel_models.loop.inference.whitening import Bins, NoiseShape, Whitening, covariance

BIN_S = DECLARED.bin_s
ROWS = 10
"""Of a bin."""

EVENLY = replace(DECLARED, robust=1e9)
"""No block counts less than another."""


def cut_into(lengths: list[int], seed: int = 0, evaluation: int = 1) -> Blocks:
    """Blocks of these lengths, some of them in the evaluation part, with two guard rows after each."""
    of_row = np.concatenate([[number] * length + [-1] * 2 for number, length in enumerate(lengths)])
    fold = np.random.default_rng(seed).permutation(np.arange(len(lengths)) % 4)
    fold[:evaluation] = -1
    return Blocks(of_row, fold)


def simulated(blocks: Blocks, shared: float, fading: float, seed: int, scale: float = 1.0) -> np.ndarray:
    """(n, 21) rows of bins of noise with these parts; the rows of a bin are alike."""
    random = np.random.default_rng(seed)
    residual = np.zeros((len(blocks.of_row), 21))
    for number in range(len(blocks)):
        rows = np.flatnonzero(blocks.of_row == number)
        count = len(rows) // ROWS
        noise = np.linalg.cholesky(covariance(count, shared, fading, BIN_S / DECLARED.fading_s))
        residual[rows] = np.repeat(noise @ random.normal(size=(count, 21)), ROWS, axis=0)
    return scale * residual


@settings(max_examples=25, deadline=None)
@given(lengths=st.lists(st.integers(1, 60), min_size=2, max_size=9), seed=st.integers(0, 99))
def test_bins_are_means_of_neighbouring_rows_of_one_block(lengths: list[int], seed: int) -> None:
    blocks = cut_into(lengths, seed)
    values = np.random.default_rng(seed).normal(size=(3, len(blocks.of_row), 2))
    bins = Bins.of(blocks, BIN_S)
    means = bins.means(values)
    assert means.shape == (3, len(bins), 2)
    assert sorted(bins.order) == list(np.flatnonzero(blocks.fit))
    edges = [*bins.starts, len(bins.order)]
    for number in range(len(bins)):
        rows = bins.order[edges[number] : edges[number + 1]]
        np.testing.assert_array_equal(np.diff(rows), 1)
        assert len(set(blocks.of_row[rows])) == 1
        assert blocks.fold[blocks.of_row[rows[0]]] == bins.fold[number]
        assert len(rows) < 2 * ROWS
        np.testing.assert_allclose(means[:, number], values[:, rows].mean(axis=1))
    assert (np.diff(bins.fold) >= 0).all()
    assert [block.stop for block in bins.blocks][-1] == len(bins)


def test_long_recordings_have_longer_bins() -> None:
    bins = Bins.of(cut_into([500] * 300), BIN_S)
    assert bins.rows_each == -(-299 * 500 // 6000)
    assert bins.seconds == pytest.approx(bins.rows_each / 100)


def test_a_basis_is_binned_as_its_regressors_are() -> None:
    blocks = cut_into([40, 63, 95, 30])
    bins = Bins.of(blocks, BIN_S)
    values = np.random.default_rng(0).normal(size=(len(blocks.of_row), 21, 2)).astype(np.float32)
    whole = bins.of_basis(Own(values))
    np.testing.assert_allclose(whole, bins.means(values.transpose(1, 0, 2).astype(float)), atol=1e-6)


def test_whitening_makes_the_covariance_of_blocks_of_any_length_the_identity() -> None:
    blocks = cut_into([50, 120, 20, 200, 70, 10])
    bins = Bins.of(blocks, BIN_S)
    residual = simulated(blocks, 0.3, 0.4, 1, scale=5.0)
    shape = NoiseShape(np.linspace(0.0, 0.6, 21), np.linspace(0.3, 0.0, 21))
    whitening = Whitening(bins, shape, residual, EVENLY)
    each = whitening(np.eye(len(bins))[None])
    for channel in (0, 7, 20):
        noise = np.zeros((len(bins), len(bins)))
        for block in bins.blocks:
            parts = shape.shared[channel], shape.fading[channel]
            noise[block, block] = covariance(block.stop - block.start, *parts, BIN_S)
        noise *= whitening.scale[channel] ** 2
        np.testing.assert_allclose(each[channel] @ noise @ each[channel].T, np.eye(len(bins)), atol=1e-9)


def test_simulated_noise_is_white_once_it_is_whitened() -> None:
    blocks = cut_into([200] * 200)
    residual = simulated(blocks, 0.3, 0.4, 2, scale=7.0)
    shape = NoiseShape(np.full(21, 0.3), np.full(21, 0.4))
    bins = Bins.of(blocks, BIN_S)
    white = Whitening(bins, shape, residual, EVENLY)(bins.means(residual.T[:, :, None]))[:, :, 0]
    by_block = white.reshape(21 * len(bins.blocks), 20)
    found = by_block.T @ by_block / len(by_block)
    np.testing.assert_allclose(found, np.eye(20), atol=0.1)


@pytest.mark.parametrize(("shared", "fading"), [(0.0, 0.0), (0.3, 0.4), (0.6, 0.0), (0.0, 0.7), (0.2, 0.7)])
def test_the_shares_of_simulated_noise_are_recovered(shared: float, fading: float) -> None:
    blocks = cut_into([300, 120, 500] * 25)
    bins = Bins.of(blocks, BIN_S)
    found = NoiseShape.of(bins, simulated(blocks, shared, fading, 3, scale=6.0), DECLARED.fading_s)
    assert found.shared.mean() == pytest.approx(shared, abs=0.08)
    assert found.fading.mean() == pytest.approx(fading, abs=0.08)


def test_a_block_that_errs_far_more_counts_less() -> None:
    blocks = cut_into([100] * 21)
    residual = np.random.default_rng(4).normal(size=(len(blocks.of_row), 21))
    far = 5
    rows = blocks.of_row == far
    residual[rows, 3] *= 10.0
    bins = Bins.of(blocks, BIN_S)
    weights = Whitening(bins, NoiseShape.usual(), residual, DECLARED).row_weights(len(residual))
    assert weights.max() == 1.0
    assert (weights[~blocks.fit] == 1.0).all()
    np.testing.assert_allclose(weights[rows, 3], 0.01, rtol=0.7)
    assert weights[rows][:, [0, 1, 2]].mean() > 0.5
    for number in range(len(blocks)):
        np.testing.assert_array_equal(np.ptp(weights[blocks.of_row == number], axis=0), 0.0)


def test_the_scale_is_at_least_that_of_rounding() -> None:
    blocks = cut_into([100] * 9)
    residual = np.zeros((len(blocks.of_row), 21))
    whitening = Whitening(Bins.of(blocks, BIN_S), NoiseShape.usual(), residual, DECLARED)
    np.testing.assert_allclose(whitening.scale, 12**-0.5)
    np.testing.assert_allclose(whitening.quantum, 1.0)


def test_what_all_channels_share_is_whitened_for_each() -> None:
    blocks = cut_into([80, 120, 60])
    bins = Bins.of(blocks, BIN_S)
    random = np.random.default_rng(5)
    features = random.normal(size=(len(blocks.of_row), 2))
    residual = random.normal(size=(len(features), 21)) * np.linspace(1, 9, 21)
    whitening = Whitening(bins, NoiseShape.usual(), residual, DECLARED)
    shared = whitening(bins.of_basis(Shared(features)))
    own = np.repeat(features[:, None], 21, axis=1).astype(np.float32)
    np.testing.assert_allclose(shared, whitening(bins.of_basis(Own(own))), atol=1e-5)


def test_a_constant_channel_that_is_predicted_exactly_counts_in_all_blocks() -> None:
    """Its blocks counted nothing, since their median error is 0, and all products with it were 0 / 0."""
    blocks = cut_into([400, 300, 500, 200])
    residual = simulated(blocks, shared=0.3, fading=0.4, seed=3, scale=20.0)
    residual[:, 0] = 0.0
    bins = Bins.of(blocks, BIN_S)
    whitening = Whitening(bins, NoiseShape.usual(), residual, DECLARED)
    assert (whitening.row_weights(len(residual))[:, 0] == 1.0).all()
    assert (whitening.ones[0] ** 2).sum() > 0
