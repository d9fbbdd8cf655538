"""Errors against NumPy's own arithmetic on the paper's definitions."""

import numpy as np
import pytest

from taxel.errors import InvalidArgument
from taxel_models.evaluation.metrics import ErrorMetrics


def test_the_four_figures_of_the_papers_tables() -> None:
    rng = np.random.default_rng(1)
    measured, predicted = rng.normal(size=(50, 21)), rng.normal(size=(50, 21)).astype(np.float32)
    std = rng.uniform(1, 9, 21)
    errors = ErrorMetrics.of(measured, predicted, tuple(std))
    difference = np.abs(measured - predicted)
    assert errors.mae == pytest.approx(difference.mean())
    assert errors.norm_mae == pytest.approx((difference / std).mean())
    assert errors.mae_electrodes == pytest.approx(difference[:, 2:].mean())
    assert errors.norm_mae_electrodes == pytest.approx((difference[:, 2:] / std[2:]).mean())
    assert set(errors.summary()) == {"mae", "norm_mae", "mae_electrodes", "norm_mae_electrodes", "rows"}
    assert errors.summary()["rows"] == 50
    assert errors.per_channel()["e19"]["mae"] == pytest.approx(difference[:, 20].mean())


@pytest.mark.parametrize(("rows", "columns"), [(3, 21), (4, 20), (0, 21)])
def test_what_cannot_be_compared_is_refused(rows: int, columns: int) -> None:
    measured = np.zeros((4 if rows else 0, 21))
    with pytest.raises(InvalidArgument, match="expected the same"):
        ErrorMetrics.of(measured, np.zeros((rows, columns), np.float32), (1.0,) * 21)
