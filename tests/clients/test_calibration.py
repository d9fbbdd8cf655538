"""A calibration by a user's own sensor."""

import math

import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray

from taxel.channels import CHANNELS
from taxel.corrections import CALIBRATION_EXTRAS, OffsetCalibration
from taxel.errors import InvalidArgument


def spoilt(value: float) -> NDArray[np.float64]:
    rows = np.zeros((3, 21))
    rows[1, CHANNELS.index("e4")] = value
    return rows


def test_it_is_the_mean_difference() -> None:
    rng = np.random.default_rng(0)
    predicted, offsets = rng.normal(2000, 100, (30, 21)), np.arange(21) - 10.0
    noise = rng.normal(0, 1, (30, 21))
    found = OffsetCalibration.of(predicted + offsets + noise, predicted)
    np.testing.assert_allclose(found.offsets, offsets + noise.mean(axis=0), atol=1e-9)
    assert list(found.extras) == [extra.name for extra in CALIBRATION_EXTRAS]
    assert found.extras["calibration_e19"] == found.offsets[20]


def test_its_age_goes_beside_it() -> None:
    found = OffsetCalibration(np.arange(21.0))
    assert found.extras_after(1.5) == {**found.extras, "calibration_age": 1.5}
    for seconds in (-0.1, math.nan, math.inf):
        with pytest.raises(InvalidArgument, match="expected a finite time from 0"):
            found.extras_after(seconds)


@pytest.mark.parametrize(
    ("measured", "predicted", "message"),
    [
        (np.zeros((3, 20)), np.zeros((3, 21)), r"measured has shape \(3, 20\)"),
        (np.zeros((3, 21)), np.zeros((2, 21)), "measured has 3 rows, predicted 2"),
        (np.zeros((0, 21)), np.zeros((0, 21)), "m above 0"),
        (np.zeros((3, 21)), spoilt(np.nan), r"predicted\[1, 'e4'\] is nan: expected finite counts"),
        (spoilt(np.inf), np.zeros((3, 21)), r"measured\[1, 'e4'\] is inf: expected finite counts"),
        ([[1.0] * 21, [1.0]], np.zeros((2, 21)), "measured: expected an array of counts"),
        (np.zeros((1, 21)), [["warm"] * 21], "predicted: expected an array of counts"),
    ],
)
def test_what_cannot_be_compared_is_refused(
    measured: ArrayLike, predicted: ArrayLike, message: str
) -> None:
    with pytest.raises(InvalidArgument, match=message):
        OffsetCalibration.of(measured, predicted)
