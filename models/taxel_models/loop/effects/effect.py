"""What an effect is: forms of it that compete for a residual, and an online form for the one that wins."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from taxel.corrections import Frame, Shape, Term, Weighted, weighted_shape
from taxel.windows import Elapsed, ExtraFeature, HistoryFeature
from taxel_models.loop.basis import Basis, Floats, Shared
from taxel_models.loop.observations import Observations
from taxel_models.loop.statistics import Fitting


@dataclass(frozen=True)
class Online:
    """How an effect is computed while a model serves.

    Attributes:
        terms: added to the model's counts.
        extras: features that they need beside the window.
        frame: how windows are turned before the model sees them.
        shift_ticks: by how much the middle of the window lies before T.
    """

    terms: tuple[Term, ...] = ()
    extras: tuple[ExtraFeature, ...] = ()
    frame: Frame | None = None
    shift_ticks: int = 0

    @property
    def changes_something(self) -> bool:
        """Whether a model can be served with it; a fault that comes and goes cannot."""
        return bool(self.terms or self.frame or self.shift_ticks)


@dataclass(frozen=True)
class Candidate:
    """One form of an effect with everything but its weights settled.

    Attributes:
        effect: its name.
        form: which form, in words.
        basis: its regressors at the observations's rows.
        fitting: how its weights are found.
        weight_names: what each weight is called, k of them.
        weight_unit: of all weights.
        settled: the figures that make this form, such as a time constant, with their units.
        online: its online form for weights (21, k).
        alike: how far its electrodes' weights may differ, SD over mean; None where they may be anything.
        certain: its signature cannot come about by chance, so that no test is needed.
        moved: puts right what the model is given, so that predictions are made anew; None for forms
            that are added to the prediction.
        again: makes the same form on other predictions; None for forms that move inputs.
    """

    effect: str
    form: str
    basis: Basis
    fitting: Fitting = field(default_factory=Fitting)
    weight_names: tuple[str, ...] = ("weight",)
    weight_unit: str = ""
    settled: Mapping[str, tuple[float, str]] = field(default_factory=dict)
    online: Callable[[Floats], Online] = lambda _: Online()
    alike: float | None = None
    certain: bool = False
    moved: Callable[[Observations], Observations] | None = None
    again: "Callable[[Observations], Candidate] | None" = None

    @property
    def moves(self) -> bool:
        """Whether it changes what the model is given."""
        return self.moved is not None


@dataclass(frozen=True)
class Remaining:
    """What is left to explain.

    Attributes:
        residual: (n, 21) measured less everything that is explained so far, counts.
        fit: (n,) rows of the fit part: no other may be looked at when a form is chosen.
        row_weights: (n,) how much each row counts.
    """

    residual: Floats
    fit: NDArray[np.bool_]
    row_weights: Floats


class Effect(ABC):
    """A nameable cause of structure in a residual.

    Attributes:
        name: one word, as in reports.
        looks_at_residual: its forms depend on what is left, so that they are made anew at each step.
        equation: what it adds to a channel.
        source: where the equation is from.
        signature: what tells it from others.
    """

    name: ClassVar[str]
    looks_at_residual: ClassVar[bool] = False
    equation: ClassVar[str]
    source: ClassVar[str]
    signature: ClassVar[str]

    @property
    def label(self) -> str:
        """What it is called in reports."""
        return self.name

    @abstractmethod
    def forms(self, observations: Observations, remaining: Remaining) -> Iterable[Candidate]:
        """Its forms on this observations; none where what it depends on was not recorded."""

    def finer(self, observations: Observations, best: Candidate) -> Iterable[Candidate]:
        """Forms around the best one, where a form is a point of a grid."""
        del observations, best
        return ()


@dataclass(frozen=True)
class Driver:
    """A feature that weights multiply, by the name that corrections know it by.

    `extra` is None for a column of the window.
    """

    name: str
    values: Floats
    extra: ExtraFeature | None = None


def past(observations: Observations, feature: HistoryFeature, name: str, unit: str) -> Driver:
    """A feature of the past as a driver; its default is the settled state."""
    extra = ExtraFeature(name=name, unit=unit, default=0.0, history=feature, taken_by="effects")
    return Driver(name, observations.history(feature), extra)


def elapsed(observations: Observations, edges: Floats) -> list[Driver]:
    """The session's time in pieces between edges, s; weights make a line of straight pieces of them."""
    return [
        past(
            observations,
            Elapsed(start_s=float(start), end_s=float(end)),
            f"elapsed[{start:.0f}:{end:.0f}s]",
            "s",
        )
        for start, end in pairwise(edges)
    ]


def given(observations: Observations, name: str, unit: str) -> Driver:
    """A recorded column as a driver, which whoever serves the model has to give; by default its mean."""
    values = observations.covariates[name]
    extra = ExtraFeature(name=name, unit=unit, default=float(values.mean()), taken_by="effects")
    return Driver(name, values, extra)


def _settles(driver: Driver) -> bool:
    """Whether it goes back to 0 when nothing happens."""
    history = None if driver.extra is None else driver.extra.history
    return history is not None and not isinstance(history, Elapsed)


def shape_of(observations: Observations, shape: Shape) -> Floats | None:
    """(n, 21) the shape that a driver is scaled by; None for 1."""
    return None if shape == "unit" else weighted_shape(shape, observations.base, observations.rest)


def weighted(
    observations: Observations,
    effect: str,
    form: str,
    shape: Shape,
    drivers: Sequence[Driver],
    *,
    centred: bool = True,
    **others: Any,
) -> Candidate:
    """A form whose regressors are a shape times drivers, less their means.

    A memory that settles stays as it is: settled, it has to add nothing.
    """
    values = np.column_stack([driver.values for driver in drivers])
    about = [centred and not _settles(driver) for driver in drivers]
    references = np.where(about, values.mean(axis=0), 0.0)
    names = tuple(driver.name for driver in drivers)

    def online(weights: Floats) -> Online:
        term = Weighted(
            shape=shape,
            features=names,
            references=tuple(references.tolist()),
            weights=tuple(tuple(row) for row in weights.T.tolist()),
            rest=tuple(observations.rest.tolist()),
        )
        return Online((term,), tuple(driver.extra for driver in drivers if driver.extra is not None))

    others.setdefault("weight_names", names)
    return Candidate(
        effect,
        form,
        Shared(values - references, shape_of(observations, shape)),
        online=online,
        again=lambda other: weighted(other, effect, form, shape, drivers, centred=centred, **others),
        **others,
    )
