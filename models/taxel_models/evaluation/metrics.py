"""Error metrics of predictions, as in the paper."""

from dataclasses import dataclass
from typing import Any, Final, Self

import numpy as np
from numpy.typing import NDArray

from taxel.channels import CHANNELS, ELECTRODE_COLUMNS
from taxel.errors import InvalidArgument

STILL_SHARE: Final = 0.1
"""A channel hardly moves if its standard deviation is below this share of that in training …"""

STILL_COUNTS: Final = 2.0
"""… or below this many counts, about the converter's noise."""


@dataclass(frozen=True)
class ErrorMetrics:
    """Mean absolute errors of one set of predictions.

    Attributes:
        rows: how many windows were compared.
        channel_mae: (21,) mean absolute error of each channel, counts.
        channel_norm_mae: (21,) the same over the channel's standard deviation in training.
        still: channels that hardly move in what was measured: a small error there proves little.
    """

    rows: int
    channel_mae: NDArray[np.float64]
    channel_norm_mae: NDArray[np.float64]
    still: tuple[str, ...]

    @classmethod
    def of(
        cls,
        measured: NDArray[np.float64],
        predicted: NDArray[np.float32] | NDArray[np.float64],
        output_std: NDArray[np.float32] | tuple[float, ...],
    ) -> Self:
        """Compare (n, 21) measured with (n, 21) predicted counts.

        Args:
            output_std: (21,) standard deviations of the training set, as in the manifest.

        Raises:
            InvalidArgument: shapes disagree or there is nothing to compare.
        """
        if measured.shape != predicted.shape or measured.ndim != 2 or not len(measured):
            raise InvalidArgument(
                f"measured {measured.shape}, predicted {predicted.shape}: expected the same (n, 21), n > 0"
            )
        mae = np.abs(measured - predicted.astype(np.float64)).mean(axis=0)
        trained = np.asarray(output_std, dtype=np.float64)
        still = measured.std(axis=0) < np.maximum(STILL_SHARE * trained, STILL_COUNTS)
        names = tuple(name for name, hardly in zip(CHANNELS, still, strict=True) if hardly)
        return cls(len(measured), mae, mae / trained, names)

    @property
    def mae(self) -> float:
        """Counts, over all channels."""
        return float(self.channel_mae.mean())

    @property
    def norm_mae(self) -> float:
        """Standard deviations, over all channels: the paper's normalised MAE."""
        return float(self.channel_norm_mae.mean())

    @property
    def mae_electrodes(self) -> float:
        """Counts, over the 19 electrodes."""
        return float(self.channel_mae[ELECTRODE_COLUMNS].mean())

    @property
    def norm_mae_electrodes(self) -> float:
        """Standard deviations, over the 19 electrodes."""
        return float(self.channel_norm_mae[ELECTRODE_COLUMNS].mean())

    def summary(self) -> dict[str, float | int]:
        """The four figures of the paper's tables and the rows they are over."""
        return {
            "mae": self.mae,
            "norm_mae": self.norm_mae,
            "mae_electrodes": self.mae_electrodes,
            "norm_mae_electrodes": self.norm_mae_electrodes,
            "rows": self.rows,
        }

    def per_channel(self) -> dict[str, dict[str, float]]:
        """Both errors of every channel by name."""
        pairs = zip(CHANNELS, self.channel_mae, self.channel_norm_mae, strict=True)
        return {name: {"mae": float(mae), "norm_mae": float(norm)} for name, mae, norm in pairs}

    def report(self) -> dict[str, Any]:
        """Everything, for JSON."""
        return {**self.summary(), "per_channel": self.per_channel(), "still": list(self.still)}
