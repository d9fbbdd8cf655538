"""z-scores in float32: the normalisation that training, export and serving share."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray


@dataclass(frozen=True)
class Scaler:
    """Subtracts a mean and divides by a standard deviation, column by column.

    All arithmetic is float32 in this order. So every implementation (NumPy, numba, an ONNX graph)
    gives the same bits.

    Attributes:
        mean: (k,) float32.
        std: (k,) float32, above 0.
    """

    mean: NDArray[np.float32]
    std: NDArray[np.float32]

    @classmethod
    def of(cls, mean: Sequence[float] | ArrayLike, std: Sequence[float] | ArrayLike) -> Self:
        """From statistics of any precision."""
        return cls(np.asarray(mean, dtype=np.float32), np.asarray(std, dtype=np.float32))

    @classmethod
    def fit(cls, values: ArrayLike) -> Self:
        """From the columns of (n, k); a column that never changes gets a standard deviation of 1."""
        array = np.asarray(values, dtype=np.float64)
        std = array.std(axis=0)
        constant = std <= 1e-12 * np.maximum(1.0, np.abs(array).max(axis=0))
        return cls.of(array.mean(axis=0), np.where(constant, 1.0, std))

    def normalise(self, values: NDArray[np.float32]) -> NDArray[np.float32]:
        """(n, k) in units to (n, k) in standard deviations."""
        return (values - self.mean) / self.std

    def restore(self, values: NDArray[np.float32]) -> NDArray[np.float32]:
        """(n, k) in standard deviations to (n, k) in units."""
        return values * self.std + self.mean
