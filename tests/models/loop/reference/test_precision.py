"""The precision of the channels' errors, and its root."""

import numpy as np
import pytest

from taxel_models.loop.inference.correlated_channels import root_of
from taxel_models.loop.reference.precision import (
    OWN_NOISE,
    likeliest_own_noise,
    parts_of,
    precision_of,
    without_itself,
)


def test_the_precision_is_the_inverse_of_the_covariance_with_some_noise_of_each_channel_added() -> None:
    random = np.random.default_rng(0)
    residual = random.normal(size=(5000, 21)) @ random.normal(size=(21, 21)) * 10 + 3.0
    covariance = np.cov(residual.T, bias=True)
    expected = np.linalg.inv(covariance + 0.03 * np.diag(np.diag(covariance)))
    np.testing.assert_allclose(precision_of(residual, 0.03), expected, rtol=1e-8)


def test_its_root_leaves_no_correlation() -> None:
    random = np.random.default_rng(1)
    residual = random.normal(size=(5000, 21)) @ random.normal(size=(21, 21)) * 10
    precision = np.linalg.inv(np.cov(residual.T, bias=True))
    root = root_of(precision)
    np.testing.assert_allclose(root.T @ root, precision, rtol=1e-8)
    np.testing.assert_allclose(np.cov((residual @ root.T).T, bias=True), np.eye(21), atol=1e-8)


def test_each_part_is_whitened_by_the_others() -> None:
    random = np.random.default_rng(2)
    residual = random.normal(size=(600, 21)) @ random.normal(size=(21, 21))
    unit = np.repeat(np.arange(6), 100)
    parts = parts_of(unit)
    precisions = [precision_of(residual[~part], 0.01) for part in parts]
    whiten = without_itself(parts, precisions)
    root = root_of(precision_of(residual[unit != 2], 0.01))
    errors = whiten(residual)
    np.testing.assert_allclose(errors[unit == 2], residual[unit == 2] @ root.T)
    np.testing.assert_allclose(whiten(2.0 * residual), 2.0 * errors)


@pytest.mark.parametrize(("rows", "least", "most"), [(20_000, 0.0, 0.001), (30, 0.003, 1.0)])
def test_few_rows_need_more_noise_of_each_channel(rows: int, least: float, most: float) -> None:
    random = np.random.default_rng(3)
    common = random.normal(size=(rows, 1)) * 10.0
    residual = common + random.normal(size=(rows, 21))
    found = likeliest_own_noise(residual, parts_of(np.arange(rows) // 3))
    assert found in OWN_NOISE
    assert least <= found <= most
