"""From cells to figures: means over folds, significance tests, and the size of the leak."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any, Final, get_args

import numpy as np

from taxel.channels import CHANNELS
from taxel_models.study.cell import CellResult, Metric
from taxel_models.study.significance import Comparison, compare, corrected
from taxel_models.study.study_settings import Protocol

METRICS: Final[tuple[Metric, ...]] = get_args(Metric)

WINDOW_PAIRS: Final = ((1, 2), (1, 3), (1, 4), (1, 5), (1, 6), (7, 1), (8, 1), (5, 6), (8, 5))
"""The input combinations that the paper compares."""

MODEL_PAIRS: Final = (
    ("xgb", "network-b"),
    ("ffnn", "network-b"),
    ("transformer", "network-b"),
    ("xgb", "ffnn"),
    ("xgb", "transformer"),
    ("transformer", "ffnn"),
)
"""The models that the paper compares."""

MEAN_PREDICTOR: Final = "mean predictor"
"""The name of the mean predictor in tables."""


@dataclass(frozen=True)
class Entry:
    """A model with an input combination, over all folds of a protocol."""

    model: str
    combination: int
    folds: tuple[CellResult, ...]

    def values(self, metric: Metric, *, electrodes: bool = False) -> list[float]:
        """The error of each fold."""
        return [fold.test.mean(metric, electrodes=electrodes) for fold in self.folds]

    @property
    def parameters(self) -> float:
        """Mean over folds, as the paper counts trees."""
        return float(np.mean([fold.parameters for fold in self.folds]))

    def figures(self) -> dict[str, dict[str, float]]:
        """Means of all errors, with their standard deviations over folds.

        As published, these are standard deviations of the folds, not estimates for further folds.
        """
        return _figures(self.values)

    def describe(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "model": self.model,
            "combination": self.combination,
            "parameters": self.parameters,
            "seconds": float(np.mean([fold.seconds for fold in self.folds])),
            "windows": [fold.windows for fold in self.folds],
            **self.figures(),
            "per_channel": {
                channel: {
                    metric: _mean_and_std([getattr(fold.test, metric)[column] for fold in self.folds])
                    for metric in METRICS
                }
                for column, channel in enumerate(CHANNELS)
            },
        }


@dataclass(frozen=True)
class PairTest:
    """A comparison of two models or combinations.

    Attributes:
        group: what both share: the model if combinations are compared, else the combination.
    """

    first: str
    second: str
    group: str
    outcome: Comparison

    @property
    def name(self) -> str:
        """As the paper writes it."""
        return f"{self.first} vs {self.second}"

    def describe(self) -> dict[str, Any]:
        """For JSON; differences of normalised MAE, 0.01 is one percent point."""
        return {"group": self.group, "first": self.first, "second": self.second, **asdict(self.outcome)}


class Summary:
    """The finished cells of one protocol.

    Args:
        cells: in the order of the settings; entries are in the order of the models.
    """

    def __init__(self, protocol: Protocol, cells: Sequence[CellResult]) -> None:
        self.protocol = protocol
        grouped: dict[tuple[str, int], list[CellResult]] = {}
        for cell in cells:
            if cell.protocol == protocol:
                grouped.setdefault((cell.model, cell.combination), []).append(cell)
        self.models = tuple(dict.fromkeys(model for model, _ in grouped))
        self.combinations = tuple(dict.fromkeys(combination for _, combination in grouped))
        self.entries: Mapping[tuple[str, int], Entry] = {
            (model, combination): Entry(model, combination, tuple(grouped[model, combination]))
            for model in self.models
            for combination in self.combinations
        }

    def mean_predictor(self) -> dict[str, dict[str, float]]:
        """Errors of the mean predictor; folds are the same for every model and combination."""
        folds = next(iter(self.entries.values())).folds
        return _figures(
            lambda metric, *, electrodes=False: [
                fold.mean_predictor.mean(metric, electrodes=electrodes) for fold in folds
            ]
        )

    @cached_property
    def window_tests(self) -> list[PairTest]:
        """Input combinations against each other, for each model; corrected together."""
        return self._tests(
            [
                (model, (model, first), (model, second), (str(first), str(second)))
                for model in self.models
                for first, second in WINDOW_PAIRS
            ]
        )

    @cached_property
    def model_tests(self) -> list[PairTest]:
        """Models against each other, for each input combination; corrected together."""
        return self._tests(
            [
                (str(combination), (first, combination), (second, combination), (first, second))
                for combination in self.combinations
                for first, second in MODEL_PAIRS
            ]
        )

    def _tests(
        self, wanted: Sequence[tuple[str, tuple[str, int], tuple[str, int], tuple[str, str]]]
    ) -> list[PairTest]:
        there = [pair for pair in wanted if pair[1] in self.entries and pair[2] in self.entries]
        outcomes = [
            compare(
                self.entries[first].values("norm_mae"),
                self.entries[second].values("norm_mae"),
                _test_ratio(self.entries[first].folds),
            )
            for _, first, second, _ in there
        ]
        return [
            PairTest(first, second, group, outcome)
            for (group, _, _, (first, second)), outcome in zip(there, corrected(outcomes), strict=True)
        ]

    def describe(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "mean_predictor": self.mean_predictor(),
            "results": [entry.describe() for entry in self.entries.values()],
            "significance": {
                "windows": [test.describe() for test in self.window_tests],
                "models": [test.describe() for test in self.model_tests],
            },
        }


def leak(strict: Summary, paper: Summary) -> list[dict[str, Any]]:
    """How much lower the paper's protocol makes the errors of each entry, and of the mean predictor.

    `share` is relative to the strict error. The standard deviations that normalise differ between the
    protocols, too. The counts and the mean predictor, which fits nothing, show by how much.
    """
    pairs: list[tuple[str, int | None, dict[str, Any], dict[str, Any]]] = [
        (model, combination, strict.entries[model, combination].figures(), entry.figures())
        for (model, combination), entry in paper.entries.items()
    ]
    pairs.append((MEAN_PREDICTOR, None, strict.mean_predictor(), paper.mean_predictor()))
    return [
        {
            "model": model,
            "combination": combination,
            **{metric: _lower(of_strict[metric]["mean"], of_paper[metric]["mean"]) for metric in METRICS},
        }
        for model, combination, of_strict, of_paper in pairs
    ]


def _lower(strict: float, paper: float) -> dict[str, float]:
    difference = strict - paper
    share = difference / strict if strict else 0.0
    return {"strict": strict, "paper": paper, "difference": difference, "share": share}


def _test_ratio(folds: Sequence[CellResult]) -> float:
    return float(np.mean([fold.windows["test"] / fold.windows["train"] for fold in folds]))


def _figures(values: Callable[..., list[float]]) -> dict[str, dict[str, float]]:
    figures: dict[str, dict[str, float]] = {}
    for metric in METRICS:
        figures[metric] = _mean_and_std(values(metric))
        figures[f"{metric}_electrodes"] = _mean_and_std(values(metric, electrodes=True))
    return figures


def _mean_and_std(values: Sequence[float]) -> dict[str, float]:
    return {"mean": float(np.mean(values)), "std": float(np.std(values))}
