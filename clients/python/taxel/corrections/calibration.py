"""A calibration by a user's own sensor: how far its channels lie from the model's."""

from dataclasses import dataclass
from typing import Final, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from taxel.channels import CHANNELS
from taxel.errors import InvalidArgument
from taxel.windows import ExtraFeature

CALIBRATION_EXTRAS: Final = tuple(
    ExtraFeature(name=f"calibration_{channel}", unit="counts", default=0.0, taken_by="effects")
    for channel in CHANNELS
)
"""The extras that a model takes which can be calibrated; 0 stands for a sensor like the model's."""

CALIBRATION_AGE: Final = ExtraFeature(name="calibration_age", unit="s", default=3600.0, taken_by="effects")
"""How long ago the calibration ended; by default so long that what fades has faded."""


@dataclass(frozen=True)
class OffsetCalibration:
    """Mean difference between a sensor and a model, taken over about a second.

    Attributes:
        offsets: (21,) measured minus predicted, counts.
    """

    offsets: NDArray[np.float64]

    @classmethod
    def of(cls, measured: ArrayLike, predicted: ArrayLike) -> Self:
        """From simultaneous rows.

        Args:
            measured: (m, 21), the sensor's channels, counts.
            predicted: (m, 21), of the version that the loop was given, called without calibration extras.

        Raises:
            InvalidArgument: shapes disagree, there is no row, or a value is not finite.
        """
        found, expected = _rows("measured", measured), _rows("predicted", predicted)
        if len(found) != len(expected):
            raise InvalidArgument(
                f"measured has {len(found)} rows, predicted {len(expected)}: expected as many"
            )
        return cls((found - expected).mean(axis=0))

    @property
    def extras(self) -> dict[str, float]:
        """By the names of `CALIBRATION_EXTRAS`, for `WindowStream.push(extras=…)`."""
        names = (extra.name for extra in CALIBRATION_EXTRAS)
        return dict(zip(names, self.offsets.tolist(), strict=True))

    def extras_after(self, seconds: float) -> dict[str, float]:
        """`extras`, and how long ago the calibration ended, for models whose offsets fade.

        Raises:
            InvalidArgument: `seconds` is negative or not finite.
        """
        if not 0.0 <= seconds < np.inf:
            raise InvalidArgument(f"{seconds} s since the calibration: expected a finite time from 0")
        return {**self.extras, CALIBRATION_AGE.name: seconds}


def _rows(name: str, values: ArrayLike) -> NDArray[np.float64]:
    """Rows of channels, checked."""
    try:
        array = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InvalidArgument(f"{name}: expected an array of counts: {error}") from None
    if array.ndim != 2 or array.shape[1] != len(CHANNELS) or not len(array):
        raise InvalidArgument(f"{name} has shape {array.shape}: expected (m, {len(CHANNELS)}), m above 0")
    finite = np.isfinite(array)
    if not finite.all():
        row, column = (int(index) for index in np.argwhere(~finite)[0])
        value = array[row, column]
        raise InvalidArgument(f"{name}[{row}, {CHANNELS[column]!r}] is {value}: expected finite counts")
    return array
