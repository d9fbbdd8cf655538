"""The normalisation of inputs and outputs as compiled code takes it."""

from typing import NamedTuple, Self

import numba
import numpy as np
from numpy.typing import NDArray

from taxel.manifest import Normalisation
from taxel.scaling import Scaler
from taxel_server.runtimes.compiled.caching import fresh


class Scales(NamedTuple):
    """Means and deviations, float32; not `applied` where the model takes raw windows and gives counts."""

    applied: bool
    input_mean: NDArray[np.float32]
    input_std: NDArray[np.float32]
    output_mean: NDArray[np.float32]
    output_std: NDArray[np.float32]

    @classmethod
    def of(cls, normalisation: Normalisation) -> Self:
        """As `taxel.scaling` rounds them."""
        inputs = Scaler.of(normalisation.input_mean, normalisation.input_std)
        outputs = Scaler.of(normalisation.output_mean, normalisation.output_std)
        return cls(not normalisation.folded, inputs.mean, inputs.std, outputs.mean, outputs.std)


@numba.njit(cache=True, nogil=True)
@fresh
def restore(scales, output, value):  # type: ignore[no-untyped-def]
    """A sum in the scale that its output was trained from."""
    return value * scales.output_std[output] + scales.output_mean[output] if scales.applied else value


@numba.njit(cache=True, nogil=True)
@fresh
def put_rows(scales, sums, each_row, each_output, first, rows, result):  # type: ignore[no-untyped-def]
    """Writes sums, whose rows and outputs are so far apart, to rows of the result, restored."""
    for row in range(rows):
        for output in range(result.shape[1]):
            result[first + row, output] = restore(
                scales, output, sums[row * each_row + output * each_output]
            )
