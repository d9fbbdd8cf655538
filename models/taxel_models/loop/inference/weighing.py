"""Weighing: an effect's forms are compared, and the likeliest that repeats is tested on held-out folds."""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from taxel_models.loop.basis import Floats
from taxel_models.loop.effects.effect import Effect
from taxel_models.loop.inference.constants import Constants
from taxel_models.loop.inference.evidence import Bases, HeldOut, Weighed, held_out, mean_odds, weigh
from taxel_models.loop.inference.forms import WhitenedForm
from taxel_models.loop.inference.products import Products
from taxel_models.loop.inference.proof import most_of_simpler, simplest, stands
from taxel_models.loop.inference.score import Score
from taxel_models.loop.inference.usual import Usual
from taxel_models.loop.inference.whitening import Whitening
from taxel_models.loop.inference.worth import held_out_error


class Option(NamedTuple):
    """One form of an effect, with or without a constant of each channel beside it.

    Attributes:
        log_evidence: in the likelier of the two cases.
        alone: log evidence without the constant.
    """

    log_evidence: float
    form: WhitenedForm
    products: Products
    weighed: Weighed
    alone: float

    @property
    def needs_constant(self) -> bool:
        """Whether it is likelier beside the constant."""
        return self.log_evidence > self.alone


class Weighing:
    """Weighs the forms of one effect beside a base.

    Args:
        usual: what the model's own held-out residual has of each effect.
        whitening: of the recording's bins.
        errors: (21, bins) of the recording, counts.
        constants: of the inference.
    """

    def __init__(self, usual: Usual, whitening: Whitening, errors: Floats, constants: Constants) -> None:
        self._usual, self._whitening, self._constants = usual, whitening, constants
        self._error = (errors**2).sum(axis=1)
        self._error_about_mean = errors.shape[1] * errors.var(axis=1)

    def likeliest(
        self,
        effect: Effect,
        forms: Sequence[WhitenedForm],
        bases: Bases,
        *,
        beside_others: bool,
        named: bool = False,
    ) -> Score:
        """The score of an effect by the likeliest of its forms, or a simpler one that carries most of it.

        Args:
            effect: which.
            forms: at least one.
            bases: what they are weighed beside.
            beside_others: something is named already.
            named: whether the effect is named already. Then a simpler form that proves itself, too, is not
                preferred to a likelier one.
        """
        weighed, total = self._weighed(effect, forms, bases)

        def tested(option: Option) -> Score:
            products = option.products
            if effect.is_constant:
                products = replace(products, base=bases.plain)
            fitting = option.form.candidate.fitting
            found = held_out(products, fitting, option.weighed)
            before, after = held_out_error(products, fitting, option.weighed, self._whitening.coloured)
            # What other effects are worth does not depend on how large a constant is.
            whole = self._error if effect.is_constant else self._error_about_mean
            fall = (before - after) / np.maximum(whole, 1e-9)
            return replace(
                self.scored(effect, option.form, option.weighed, option.log_evidence, found, fall),
                needs_constant=option.needs_constant,
                log_evidence_alone=option.alone,
            )

        best = tested(max(weighed, key=lambda option: option.log_evidence))
        likeliest = best
        most = most_of_simpler(best, self._constants)
        while simpler := [option for option in weighed if option.form.freedom <= most]:
            simple = tested(max(simpler, key=lambda option: option.log_evidence))
            most = most_of_simpler(simple, self._constants)
            if simple.log_evidence > 0:
                # Many weights can make a form likely that does not repeat, though a simpler one does.
                proven = tuple(stands(one, beside_others, self._constants) for one in (best, simple))
                if proven == (False, True):
                    best = simple
                elif proven != (True, False) and not named:
                    best = simplest(best, [simple], self._constants)
        sizes = tuple((option.form.freedom, option.log_evidence) for option in weighed)
        gain = None if best is likeliest else likeliest.total_gain
        return replace(best, log_evidence=total, likeliest_gain=gain, forms=sizes)

    def _weighed(
        self, effect: Effect, forms: Sequence[WhitenedForm], bases: Bases
    ) -> tuple[list[Option], float]:
        """Each form, with a constant or without one, and the log evidence of all together."""
        weighed: list[Option] = []
        logs = []
        for form in forms:
            fitting = form.candidate.fitting
            usual = self._usual.log_evidence(effect.label, form.candidate)
            products = Products.of(bases.beside, form.design)
            plain = weigh(replace(products, base=bases.plain), fitting, self._constants, usual)
            alone = plain.log_evidence
            options = [Option(alone, form, products, plain, alone)]
            if not effect.is_constant:
                second = weigh(products, fitting, self._constants, usual)
                value = second.log_evidence + bases.constant
                options.append(Option(value, form, products, second, alone))
            logs.append(mean_odds([option.log_evidence for option in options]))
            weighed.append(max(options, key=lambda option: option.log_evidence))
        return about_mean_or_not(weighed), mean_odds(logs)

    def scored(
        self,
        effect: Effect,
        form: WhitenedForm,
        weighed: Weighed,
        log_evidence: float,
        tested: HeldOut,
        fall: Floats,
    ) -> Score:
        """The score of a form less what its effect explains of the model's own held-out residual.

        Args:
            effect: the form's.
            form: that was weighed.
            weighed: its evidence.
            log_evidence: of the effect.
            tested: on held-out folds.
            fall: (21,) share of each channel's squared error that goes on these folds.
        """
        # A channel that it does not change gains nothing, usual or not.
        candidate = form.candidate
        usual = self._usual.gain(candidate, tested) * weighed.changes
        gain = tested.gain - usual
        whole, own = tested.gain.sum(axis=0), gain.sum(axis=0)
        # So much of what goes is news: the model's own residual has the rest.
        news = np.clip(own / np.where(whole > 0, whole, np.inf), -1.0, 1.0)
        worth = np.where(fall > 0, fall * news, fall)
        usual = usual * np.ones_like(gain)
        return Score(effect, form, weighed, log_evidence, gain, worth, usual)


def about_mean_or_not(weighed: Sequence[Option]) -> list[Option]:
    """The same, but one of each two forms that are there with their mean and without it, beside a constant.

    The constant stands for the mean. It is not served with the form, so that the likelier one alone counts.
    """
    kept: dict[str, Option] = {}
    for option in weighed:
        own = option.form.candidate.form_itself
        other = kept.get(own)
        if other is None or not (option.needs_constant and other.needs_constant):
            kept[own if other is None else option.form.candidate.form] = option
        elif option.alone > other.alone:
            kept[own] = option
    return list(kept.values())
