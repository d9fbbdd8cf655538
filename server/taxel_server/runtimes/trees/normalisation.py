"""The normalisation of inputs and outputs as compiled code takes it."""

from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from taxel.manifest import Normalisation
from taxel.scaling import Scaler
from taxel_server.runtimes.compiled.arguments import array_in, number_in
from taxel_server.runtimes.compiled.compiling import compiled, inlined


class Scales(NamedTuple):
    """Means and standard deviations, float32. They are not `applied` if the model takes raw windows."""

    applied: bool
    input_mean: NDArray[np.float32]
    input_std: NDArray[np.float32]
    output_mean: NDArray[np.float32]
    output_std: NDArray[np.float32]

    @classmethod
    def of(cls, normalisation: Normalisation) -> Self:
        """The values of a normalisation, rounded as `taxel.scaling` rounds them."""
        inputs = Scaler.of(normalisation.input_mean, normalisation.input_std)
        outputs = Scaler.of(normalisation.output_mean, normalisation.output_std)
        return cls(not normalisation.folded, inputs.mean, inputs.std, outputs.mean, outputs.std)


@inlined
def read_scales(arguments: NDArray[np.int64], first: int) -> Scales:
    """The scales that are packed from an entry of the arguments on."""
    return Scales(
        number_in(arguments, first) != 0,
        array_in(arguments, first + 1, np.float32),
        array_in(arguments, first + 2, np.float32),
        array_in(arguments, first + 3, np.float32),
        array_in(arguments, first + 4, np.float32),
    )


@compiled
def restore(scales: Scales, output: int, value: np.float32) -> np.float32:
    """Turns a sum of an output back into counts."""
    return value * scales.output_std[output] + scales.output_mean[output] if scales.applied else value


@compiled
def put_rows(
    scales: Scales,
    sums: NDArray[np.float32],
    each_row: int,
    each_output: int,
    first: int,
    rows: int,
    result: NDArray[np.float32],
) -> None:
    """Writes sums to rows of the result, as counts. The strides of rows and outputs are given."""
    for row in range(rows):
        for output in range(result.shape[1]):
            result[first + row, output] = restore(
                scales, output, sums[row * each_row + output * each_output]
            )
