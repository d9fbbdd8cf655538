"""Network B's errors with the measured temperature, the mean, and every temperature that occurs."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from taxel_models.study.cell import CellResult
from taxel_models.study.published import published_temperature
from taxel_models.study.study_settings import SWEPT, Protocol
from taxel_models.study.study_tables import Table
from taxel_models.study.summary import MEAN_PREDICTOR, Summary
from taxel_models.study.sweep import TemperatureSweep

_OfFolds = NDArray[np.float64]


@dataclass(frozen=True)
class FoldErrors:
    """Errors over all channels, (folds,) each."""

    mae: _OfFolds
    norm_mae: _OfFolds

    def describe(self) -> dict[str, Any]:
        """For JSON."""
        return {
            name: {"mean": float(values.mean()), "std": float(values.std())}
            for name, values in (("mae", self.mae), ("norm_mae", self.norm_mae))
        }


@dataclass(frozen=True)
class FixedTemperature:
    """Network B with one temperature for all windows.

    Attributes:
        tdc: the temperature, counts; the mean over folds if it differs between them.
    """

    tdc: float
    errors: FoldErrors


@dataclass(frozen=True)
class Temperature:
    """A protocol's swept cells.

    Attributes:
        measured: errors with the measured temperature.
        mean: errors with the mean temperature of the training set.
        mean_predictor: errors of the mean predictor.
        tdc: every temperature that occurs, counts, (k,).
        mae: errors with each of them, counts, (folds, k).
        norm_mae: the same, normalised, (folds, k).
    """

    protocol: Protocol
    measured: FoldErrors
    mean: FixedTemperature
    mean_predictor: FoldErrors
    tdc: NDArray[np.float64]
    mae: NDArray[np.float64]
    norm_mae: NDArray[np.float64]

    @classmethod
    def of(cls, summary: Summary) -> "Temperature | None":
        """From the cells of a protocol; None if they have no sweep."""
        entry = summary.entries.get(SWEPT)
        if entry is None:
            return None
        sweeps = [fold.sweep for fold in entry.folds if fold.sweep is not None]
        if len(sweeps) < len(entry.folds):
            return None
        return cls(
            summary.protocol,
            measured=_errors(entry.folds, "test_measured_temperature"),
            mean=FixedTemperature(
                float(np.mean([sweep.mean_tdc for sweep in sweeps])), _errors(entry.folds, "test")
            ),
            mean_predictor=_errors(entry.folds, "mean_predictor"),
            tdc=np.array(sweeps[0].tdc),
            mae=_curves(sweeps, "mae"),
            norm_mae=_curves(sweeps, "norm_mae"),
        )

    @property
    def best(self) -> FixedTemperature:
        """The fixed temperature with the lowest normalised MAE (mean over folds)."""
        return self._at(int(self.norm_mae.mean(axis=0).argmin()))

    @property
    def worst(self) -> FixedTemperature:
        """The fixed temperature with the highest normalised MAE (mean over folds)."""
        return self._at(int(self.norm_mae.mean(axis=0).argmax()))

    def relative_loss(self, fixed: FixedTemperature) -> float:
        """The relative loss of this temperature against the measured one.

        As in the paper, it is the difference of the normalised MAE over the mean predictor's:
        (0.228 - 0.096) / 0.537 is its 24.4 %, apart from rounding.
        """
        lost = fixed.errors.norm_mae.mean() - self.measured.norm_mae.mean()
        return float(lost / self.mean_predictor.norm_mae.mean())

    def describe(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "model": SWEPT[0],
            "combination": SWEPT[1],
            "measured": self.measured.describe(),
            **{
                name: {
                    "tdc": fixed.tdc,
                    **fixed.errors.describe(),
                    "relative_loss": self.relative_loss(fixed),
                }
                for name, fixed in (("mean", self.mean), ("best", self.best), ("worst", self.worst))
            },
            "mean_predictor": self.mean_predictor.describe(),
            "sweep": {
                "tdc": self.tdc.tolist(),
                "norm_mae": self.norm_mae.mean(axis=0).tolist(),
                "norm_mae_std": self.norm_mae.std(axis=0).tolist(),
            },
        }

    def _at(self, place: int) -> FixedTemperature:
        return FixedTemperature(
            float(self.tdc[place]), FoldErrors(self.mae[:, place], self.norm_mae[:, place])
        )


def temperature_table(found: Temperature, *, published: bool) -> Table:
    """Errors and relative losses by Network B's given temperature.

    Args:
        published: put the paper's normalised MAE beside ours.
    """
    known = published_temperature()
    labels = (("mean", "its mean"), ("best", "best fixed"), ("worst", "worst fixed"))
    rows = [_row("as measured", "", found.measured, "", known.get("measured"))]
    for name, label in labels:
        fixed: FixedTemperature = getattr(found, name)
        loss = f"{100 * found.relative_loss(fixed):.1f} %"
        rows.append(_row(label, f"{fixed.tdc:.1f}", fixed.errors, loss, known.get(name)))
    rows.append(_row(MEAN_PREDICTOR, "", found.mean_predictor, "", known.get("mean_predictor")))
    head = ("given temperature", "tdc", "norm. MAE", "MAE", "relative loss", "published norm. MAE")
    paper = f" Published relative loss of the best: {100 * known['relative_loss']:.1f} %."
    return Table(
        f"temperature-{found.protocol}",
        f"Protocol {found.protocol}: {SWEPT[0]}, inputs {SWEPT[1]}, by its given temperature; "
        "mean over folds, standard deviation in parentheses. Relative loss: the normalised MAE less that "
        "with the measured temperature, over that of the mean predictor." + (paper if published else ""),
        head if published else head[:-1],
        tuple(row if published else row[:-1] for row in rows),
    )


def _row(label: str, tdc: str, errors: FoldErrors, loss: str, known: float | None) -> tuple[str, ...]:
    means_and_stds = (
        f"{values.mean():.3f} ({values.std():.3f})" for values in (errors.norm_mae, errors.mae)
    )
    return (label, tdc, *means_and_stds, loss, "" if known is None else f"{known:.3f}")


def _errors(folds: Sequence[CellResult], name: str) -> FoldErrors:
    parts = [getattr(fold, name) for fold in folds]
    return FoldErrors(
        np.array([part.mean("mae") for part in parts]),
        np.array([part.mean("norm_mae") for part in parts]),
    )


def _curves(sweeps: Sequence[TemperatureSweep], name: str) -> NDArray[np.float64]:
    return np.array([getattr(sweep, name) for sweep in sweeps])
