"""Extra features: values that a model takes in addition to its window."""

from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import FiniteFloat

from taxel.errors import InvalidArgument
from taxel.schema import Schema
from taxel.windows.history import HistoryFeature, history_columns
from taxel.windows.samples import Samples, resample


class ExtraFeature(Schema):
    """A value that a model takes in addition to its window, such as the sensor's temperature `tdc`.

    The window builder computes an extra that has a `history`. The caller gives any other extra. If the
    caller leaves it out, it takes its `default`. For a history the default is 0, which means settled; what
    has the load itself in it defaults to its mean in the recordings.

    Attributes:
        taken_by: what uses it: the model file, or the effects that correct its prediction.
    """

    name: str
    unit: str
    default: FiniteFloat = 0.0
    history: HistoryFeature | None = None
    taken_by: Literal["model", "effects"] = "model"


def extra_columns(
    samples: Samples,
    extras: Sequence[ExtraFeature],
    given: Mapping[str, NDArray[np.float64]],
) -> NDArray[np.float64]:
    """Extra features at every tick of a recording.

    Args:
        samples: n samples.
        given: values by name, each (n,). An extra that is neither a history nor given takes its
            default. Names that are no extra are ignored.

    Returns:
        (ticks, extras).

    Raises:
        InvalidArgument: a given column has another length.
    """
    used = {extra.name: given[extra.name] for extra in extras if extra.name in given}
    for name, values in used.items():
        if values.shape != (len(samples),):
            raise InvalidArgument(f"{name} has shape {values.shape}: expected ({len(samples)},)")
    if used and not samples.are_ticks:
        _, resampled = resample(samples, np.column_stack(list(used.values())))
        used = dict(zip(used, resampled.T, strict=True))
    ticks = samples.ticks()
    columns = np.empty((len(ticks), len(extras)))
    for column, extra in enumerate(extras):
        if extra.history is not None:
            columns[:, column] = history_columns(ticks, [extra.history])[:, 0]
        else:
            columns[:, column] = used.get(extra.name, extra.default)
    return columns
