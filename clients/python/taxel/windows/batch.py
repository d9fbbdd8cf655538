"""Windows of a whole recording at once."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from taxel.windows.combinations import WindowSpec
from taxel.windows.extras import ExtraFeature, extra_columns
from taxel.windows.samples import Samples
from taxel.windows.window_columns import window_columns


@dataclass(frozen=True)
class Windows:
    """Windows of a recording, and the row of each in it.

    Attributes:
        values: (m, f) float32, columns as `WindowSpec.features`, then the extras.
        rows: (m,) row of T among the ticks that the windows were built from.
    """

    values: NDArray[np.float32]
    rows: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.rows)


def build_windows(
    samples: Samples,
    spec: WindowSpec,
    extras: Sequence[ExtraFeature] = (),
    given: Mapping[str, NDArray[np.float64]] | None = None,
) -> Windows:
    """Every window of `samples` whose steps all lie inside one segment.

    Samples that are not 10 ms ticks are resampled first; then `Windows.rows` counts the rows
    of `samples.ticks()`.

    Args:
        extras: further columns behind the window's; `manifest.window.extras` for a loaded model.
        given: values of extras by name, one a sample; see `extra_columns`.

    Raises:
        InvalidArgument: a given column has another length than the samples.
    """
    ticks = samples.ticks()
    rows = _complete_rows(ticks, spec)
    middle = rows - spec.shift
    columns = window_columns(
        spec, lambda step: ticks.position[middle + step], lambda step: ticks.force[middle + step]
    )
    if extras:
        columns.append(extra_columns(samples, extras, given or {})[rows])
    return Windows(np.concatenate(columns, axis=1).astype(np.float32), rows)


def _complete_rows(ticks: Samples, spec: WindowSpec) -> NDArray[np.int64]:
    """Rows T with every needed step in their own segment."""
    parts = [
        np.arange(segment.start + spec.look_back, segment.stop - spec.look_ahead, dtype=np.int64)
        for segment in ticks.segments
    ]
    return np.concatenate([np.empty(0, np.int64), *parts])
