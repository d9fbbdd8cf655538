"""The interface of effects: their forms compete for a residual, and the best one has an online form."""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import ClassVar, Final, Literal

import numpy as np
from numpy.typing import NDArray

from taxel.channels import CHANNELS, ELECTRODE_COLUMNS
from taxel.corrections import ONE, Frame, Term, Weighted
from taxel.held_out_residual import OwnWave
from taxel.windows import ExtraFeature
from taxel_models.loop.basis import AboutMean, Basis, Floats
from taxel_models.loop.observations import Observations


@dataclass(frozen=True)
class Fitting:
    """How weights are fitted.

    Attributes:
        pooled: whether all channels share their weights, as they share the cause.
        fixed: whether the weights are 1 and nothing is fitted.
        positive: whether a weight below 0 contradicts the cause; for forms of one regressor.
        allowed: (21,), which channels may change; None for all.
        prior: (k,) each regressor's prior size over the usual one, for many collinear regressors.
        choices: how many regressors each channel's one was chosen from, or how many motions.
        beforehand: how many parameters of the form, such as a motion's, were fitted beforehand.
        few_channels: whether it changes few channels, and is weighed beside all others.
        compared: so many moments or the like were compared on the blocks that test it, so that chance
            has so many tries (Bonferroni).
    """

    pooled: bool = False
    fixed: bool = False
    positive: bool = False
    allowed: NDArray[np.bool_] | None = None
    prior: Floats | None = None
    choices: int = 1
    beforehand: int = 0
    few_channels: bool = False
    compared: int = 1


ELECTRODES_ALIKE: Final = Fitting(
    pooled=True, allowed=np.isin(np.arange(len(CHANNELS)), np.arange(len(CHANNELS))[ELECTRODE_COLUMNS])
)
"""All electrodes share their weights, and the pressure sensor has none."""

SHARED_WEIGHTS: Final[Mapping[str, Fitting]] = {
    "all channels alike": Fitting(pooled=True),
    "all electrodes alike": ELECTRODES_ALIKE,
}
"""How channels may share weights, by what a form's name says of it. Skin and fluid are the electrodes' own:
the pressure sensor does not feel how they wear."""


@dataclass(frozen=True)
class Online:
    """How an effect is computed while a model is served.

    Attributes:
        terms: what is added to the model's counts.
        extras: the features beside the window that the terms need.
        frame: how windows are turned before the model takes them.
        shift_ticks: how many ticks the middle of the window lies before T.
    """

    terms: tuple[Term, ...] = ()
    extras: tuple[ExtraFeature, ...] = ()
    frame: Frame | None = None
    shift_ticks: int = 0

    @property
    def changes_something(self) -> bool:
        """Whether a model can be served with it. A fault that comes and goes cannot, nor interference."""
        return bool(self.terms or self.frame or self.shift_ticks)


ABOUT_MEAN: Final = ", about its mean"
"""Ends the name of a form that is taken less its mean."""


@dataclass(frozen=True)
class Candidate:
    """One form of an effect. Only its weights are not known yet.

    Attributes:
        effect: the effect's name.
        form: the form, described in a few words.
        basis: its regressors at the rows of the observations.
        fitting: how its weights are fitted.
        weight_names: the k names of the weights.
        weight_units: the k units of the weights, or one of all.
        sources: of each channel, the other one whose signal it takes; none where there is none.
        form_parameters: the parameters of this form, such as a time constant, with their units.
        online: gives the online form for weights (21, k).
        alike: the largest SD over mean of the electrodes' weights; None if they may differ freely.
        certain: whether chance cannot cause its signature. Then it needs no test.
        mean_absorbed: whether a trained model may have absorbed its mean.
        ages: whether it grows or fades over the session, so that some folds have more of it than others.
        uneven: whether some folds have more of it than others for another reason: each kind, such as a
            material, has its own weights, or it has a course over the session.
        contains: a simpler effect that its weights can stand for: it is no rival of that one. None without.
        moved: gives the observations with corrected inputs and new predictions; None for forms that add to
            the prediction.
        again: gives the same form for other predictions; None for forms that move inputs.
    """

    effect: str
    form: str
    basis: Basis
    fitting: Fitting = field(default_factory=Fitting)
    weight_names: tuple[str, ...] = ("weight",)
    weight_units: tuple[str, ...] = ("",)
    sources: tuple[str, ...] = ()
    form_parameters: Mapping[str, tuple[float, str]] = field(default_factory=dict)
    online: Callable[[Floats], Online] = lambda _: Online()
    alike: float | None = None
    certain: bool = False
    mean_absorbed: bool = True
    ages: bool = False
    uneven: bool = False
    contains: str | None = None
    moved: Callable[[Observations], Observations] | None = None
    again: "Callable[[Observations], Candidate] | None" = None

    @property
    def form_itself(self) -> str:
        """The form, whether it is taken about its mean or not."""
        return self.form.removesuffix(ABOUT_MEAN)

    @property
    def moves(self) -> bool:
        """Whether it changes the model's inputs."""
        return self.moved is not None

    @property
    def acts_unevenly(self) -> bool:
        """Whether it is of a kind that acts in some folds more than in others."""
        return self.ages or self.uneven or self.moves


def about_mean(candidate: Candidate, means: Floats) -> Candidate:
    """The same form less its mean, which the model has absorbed.

    Args:
        means: (1 or 21, k) of its regressors.
    """
    basis = AboutMean(candidate.basis, means)

    def online(weights: Floats) -> Online:
        served, constants = candidate.online(weights), basis.constants(weights)
        term = Weighted(
            shape="unit", features=(ONE,), references=(0.0,), weights=(tuple((-constants).tolist()),)
        )
        return replace(served, terms=(*served.terms, term))

    def again(observations: Observations) -> Candidate:
        assert candidate.again is not None
        return about_mean(candidate.again(observations), means)

    form = candidate.form + ABOUT_MEAN
    return replace(candidate, form=form, basis=basis, online=online, again=again)


@dataclass(frozen=True)
class Remaining:
    """The part of the residual that no named effect explains.

    Attributes:
        residual: (n, 21) measured less predicted, less the named effects, counts.
        fit: (n,) the rows of the fit part. A form may be chosen only by these.
        row_weights: (n,) how much each row counts.
        waves: with as much energy as is usual of the model.
        beside: the regressors of the named effects that have weights of each channel. Whatever is found of
            the residual is inferred together with these weights.
        explained: gives (k, 21) how much of each channel's error each of some signals (n, k) explains
            beside its own (n, 21), as all channels together tell; None where rows tell that.
    """

    residual: Floats
    fit: NDArray[np.bool_]
    row_weights: Floats
    waves: Sequence[OwnWave] = ()
    beside: Sequence[Basis] = ()
    explained: Callable[[Floats, Floats], Floats] | None = None


class Effect(ABC):
    """A nameable cause of structure in a residual.

    Attributes:
        name: one word, as in reports.
        looks_at_residual: whether its forms depend on the residual. Then each step makes them again.
        is_constant: whether it is a constant of each channel. All others are tested beside one.
        is_steady: whether it is nearly constant within a contact, whatever happens there.
        is_of_one_channel: whether each channel has it for itself, such as a limit of its own.
        is_predictable: whether a model can predict it. Otherwise it is only reported.
        follows: which signal a change of few channels is in proportion to: `expected`, what the model and
            the other channels foretell of the channel, or `measured`, that of another channel; None if the
            effect changes many channels.
        most_weight: the largest weight that a channel can have of the signal that it follows.
        is_costly: whether its forms take many predictions. Then it is tried again once at most: after it
            failed alone, beside others.
        fits_nothing: whether nothing of a form is fitted, such as a delay of 20 ms: it changes every
            recording alike. What the model's own residual has of one form says nothing of others, and
            one that repeats may be named though it removes little.
        equation: what it adds to a channel.
        source: the source of the equation.
        signature: how it differs from other effects.
    """

    name: ClassVar[str]
    looks_at_residual: ClassVar[bool] = False
    is_costly: ClassVar[bool] = False
    fits_nothing: ClassVar[bool] = False
    follows: ClassVar[Literal["expected", "measured"] | None] = None
    most_weight: ClassVar[float] = math.inf
    is_constant: ClassVar[bool] = False
    is_steady: ClassVar[bool] = False
    is_of_one_channel: ClassVar[bool] = False
    is_predictable: ClassVar[bool] = True
    equation: ClassVar[str]
    source: ClassVar[str]
    signature: ClassVar[str]

    @property
    def label(self) -> str:
        """Its name in reports."""
        return self.name

    @abstractmethod
    def forms(self, observations: Observations, remaining: Remaining) -> Iterable[Candidate]:
        """Its forms for these observations. There are none if they lack what the effect depends on."""

    def out_of_scope(self, observations: Observations) -> str | None:
        """Why these observations cannot show the effect, although they have the columns; else None."""
        del observations
        return None

    def finer(
        self, observations: Observations, best: Candidate, fit: NDArray[np.bool_]
    ) -> Iterable[Candidate]:
        """Forms around the best one, if forms are points of a grid, and what it may have beside it.

        Args:
            fit: (n,) the rows of the fit part.
        """
        del observations, best, fit
        return ()

    @classmethod
    def why_only_reported(cls, form: str) -> str:
        """Why no model is served with a form that changes nothing online, and what to do about it."""
        del form
        return "what it depends on is not known while serving"

    def by_rows(
        self, observations: Observations, best: Candidate, residual: Floats, fit: NDArray[np.bool_]
    ) -> Candidate:
        """The form near the best one that single rows are best served with; evidence is of their means.

        Args:
            residual: (n, 21) that named effects leave, counts.
            fit: (n,) the rows of the fit part.
        """
        del observations, residual, fit
        return best
