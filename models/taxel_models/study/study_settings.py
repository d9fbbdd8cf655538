"""The settings of a study, and the cells that it consists of."""

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Final, Literal, get_args

from taxel.errors import SettingsError
from taxel.windows import COMBINATIONS
from taxel_models.families.registry import FAMILIES, family, resolve
from taxel_models.training.split import Grouping

Protocol = Literal["strict", "paper"]
"""`strict` lets nothing leak from test to training; `paper` repeats the published choices."""

PROTOCOLS: Final[tuple[Protocol, ...]] = get_args(Protocol)

PUBLISHED_MODELS: Final = ("network-b", "xgb", "ffnn", "transformer")
"""The four that the paper compares, the baseline first."""

SWEPT: Final = ("network-b", 1)
"""Model and input combination of the paper's figure on the temperature."""

_KEY_VERSION: Final = 1
"""Counted up when cells computed before are no longer comparable."""


@dataclass(frozen=True, order=True)
class Cell:
    """One training: a model with an input combination on one fold."""

    protocol: Protocol
    combination: int
    fold: int
    model: str

    @property
    def name(self) -> str:
        """For file names and progress; folds count from 1."""
        return f"{self.protocol}-{self.model}-{self.combination}-fold{self.fold + 1}"


@dataclass(frozen=True)
class StudySettings:
    """What to compare, and on how much.

    Attributes:
        models: family names.
        combinations: input combinations, 1..8.
        folds: number of folds.
        grouping: what the strict protocol holds out whole.
        rows: 10 ms ticks to reduce the data to; None takes all.
        seed: seed of the folds, the reduction, and every fit.
        overrides: by model, hyperparameters that replace the paper's.
        temperature: test Network B with every temperature that occurs.
    """

    models: tuple[str, ...] = PUBLISHED_MODELS
    combinations: tuple[int, ...] = COMBINATIONS
    protocols: tuple[Protocol, ...] = ("strict",)
    folds: int = 10
    grouping: Grouping = "auto"
    rows: int | None = None
    seed: int = 0
    overrides: Mapping[str, dict[str, Any]] = field(default_factory=dict)
    temperature: bool = False

    def __post_init__(self) -> None:
        checks: tuple[tuple[str, Sequence[Any], Sequence[Any]], ...] = (
            ("models", self.models, FAMILIES),
            ("inputs", self.combinations, COMBINATIONS),
            ("protocols", self.protocols, PROTOCOLS),
        )
        for name, chosen, known in checks:
            unknown = [value for value in chosen if value not in known]
            if unknown or not chosen or len(set(chosen)) < len(chosen):
                raise SettingsError(
                    f"{name} {', '.join(map(str, chosen)) or '(none)'}: "
                    f"expected each once, of {', '.join(map(str, known))}"
                )
        if self.folds < 2:
            raise SettingsError(f"{self.folds} folds: expected at least 2")
        idle = sorted(set(self.overrides) - set(self.models))
        if idle:
            raise SettingsError(
                f"--set {idle[0]}.…: {idle[0]!r} is none of the models, {', '.join(self.models)}"
            )
        if self.temperature and (SWEPT[0] not in self.models or SWEPT[1] not in self.combinations):
            raise SettingsError(
                f"--temperature: expected {SWEPT[0]} among the models and input combination {SWEPT[1]}"
            )

    @cached_property
    def hyperparameters(self) -> dict[tuple[str, int], dict[str, Any]]:
        """What each model is fitted with for each combination.

        Raises:
            SettingsError: an override is unknown or not valid.
        """
        return {
            (model, combination): resolve(
                family(model), combination, dict(self.overrides.get(model, {}))
            ).model_dump(mode="json")
            for model in self.models
            for combination in self.combinations
        }

    def check(self) -> None:
        """Check the hyperparameters before any work.

        Raises:
            SettingsError: an override is unknown or not valid.
        """
        _ = self.hyperparameters

    def cells(self) -> list[Cell]:
        """Every cell; those of one fold's windows stand together."""
        return [
            Cell(protocol, combination, fold, model)
            for protocol in self.protocols
            for combination in self.combinations
            for fold in range(self.folds)
            for model in self.models
        ]

    def sweeps(self, cell: Cell) -> bool:
        """Whether this cell is to be tested with every temperature that occurs."""
        return self.temperature and (cell.model, cell.combination) == SWEPT

    def key(self, cell: Cell, fingerprints: Sequence[str], grouping: Grouping) -> str:
        """The hash of everything that a cell's result depends on: data, folds, settings.

        Args:
            fingerprints: those of the recordings as read, before any reduction.
            grouping: what `auto` became.
        """
        content: dict[str, Any] = {
            "version": _KEY_VERSION,
            "data": list(fingerprints),
            "rows": self.rows,
            "folds": self.folds,
            "unit": grouping,
            "seed": self.seed,
            "cell": [cell.protocol, cell.model, cell.combination, cell.fold],
            "hyperparameters": self.hyperparameters[cell.model, cell.combination],
        }
        if self.sweeps(cell):
            content["sweep"] = True
        return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def parse_overrides(settings: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """`{"xgb.eta": 0.1}` as `{"xgb": {"eta": 0.1}}`.

    Raises:
        SettingsError: a name is not MODEL.NAME.
    """
    overrides: dict[str, dict[str, Any]] = {}
    for setting, value in settings.items():
        model, dot, name = setting.partition(".")
        if not dot or not name or model not in FAMILIES:
            raise SettingsError(f"--set {setting}=…: expected MODEL.NAME=VALUE, such as xgb.eta=0.1")
        overrides.setdefault(model, {})[name] = value
    return overrides


def parse_combinations(text: str) -> tuple[int, ...]:
    """Input combinations from `1-8` or `1,3,5-8`.

    Raises:
        SettingsError: a part is neither a number nor a range.
    """
    numbers: list[int] = []
    for part in text.split(","):
        first, dash, last = part.strip().partition("-")
        if not first.isdecimal() or (dash and not last.isdecimal()):
            raise SettingsError(f"--inputs {text}: expected numbers and ranges, such as 1-8 or 1,3,5-8")
        numbers += range(int(first), int(last or first) + 1)
    return tuple(numbers)
