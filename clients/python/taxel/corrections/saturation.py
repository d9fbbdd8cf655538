"""Saturation: beyond a level a channel answers less than the model says."""

from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from taxel.corrections.term import BaseTerm, Columns
from taxel.schema import PerChannel


class Saturation(BaseTerm):
    """delta_c = -slope_c sign(s) max(|s| - level_c, 0), with s = p_c - rest_c.

    Attributes:
        slope: share of the response beyond the level that is lost: 1 is a hard limit, 0 none.
        level: counts from rest.
        rest: resting value of each channel, counts.
    """

    kind: Literal["saturation"] = "saturation"
    slope: PerChannel
    level: PerChannel
    rest: PerChannel

    @override
    def delta(self, p: NDArray[np.float64], columns: Columns) -> NDArray[np.float64]:
        slope, level, rest = self._arrays
        return slope * saturation_design(p - rest, level)

    @cached_property
    def _arrays(self) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        return np.array(self.slope), np.array(self.level), np.array(self.rest)


def saturation_design(signal: NDArray[np.float64], level: NDArray[np.float64]) -> NDArray[np.float64]:
    """What a saturation with slope 1 adds.

    Args:
        signal: (n, 21), counts from rest.
        level: (21,), counts from rest.

    Returns:
        (n, 21), counts: -sign(s) max(|s| - level, 0).
    """
    return np.asarray(-np.sign(signal) * np.maximum(np.abs(signal) - level, 0.0))
