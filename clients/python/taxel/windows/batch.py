"""Windows of a whole recording at once."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from taxel.windows.combinations import WindowSpec
from taxel.windows.neighbours import nearest_moved, steps_of
from taxel.windows.samples import Samples


@dataclass(frozen=True)
class Windows:
    """Windows of a recording and where each stands in it.

    Attributes:
        values: (m, f) float32, columns as `WindowSpec.features`.
        rows: (m,) row of T among the ticks that the windows were built from.
    """

    values: NDArray[np.float32]
    rows: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.rows)


def build_windows(samples: Samples, spec: WindowSpec) -> Windows:
    """Every window of `samples` whose steps all lie inside one segment.

    Samples that are not 10 ms ticks are resampled first; then `Windows.rows` counts the rows
    of `samples.ticks()`.
    """
    ticks = samples.ticks()
    rows = _complete_rows(ticks, spec)
    now = ticks.position[rows]
    columns = [
        nearest_moved(now, (ticks.position[rows + step] for step in steps_of(which)))
        for which in spec.positions
    ]
    columns += [ticks.force[rows + step] for step in spec.force_steps]
    return Windows(np.concatenate(columns, axis=1).astype(np.float32), rows)


def _complete_rows(ticks: Samples, spec: WindowSpec) -> NDArray[np.int64]:
    """Rows T with every needed step in their own segment."""
    parts = [
        np.arange(segment.start + spec.look_back, segment.stop - spec.look_ahead, dtype=np.int64)
        for segment in ticks.segments
    ]
    return np.concatenate([np.empty(0, np.int64), *parts])
