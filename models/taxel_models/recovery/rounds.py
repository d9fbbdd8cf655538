"""Rounds and what they come to: confusion, rates with intervals, power by cause and strength."""

from collections import Counter
from collections.abc import Sequence
from typing import Annotated, Any, Final

import numpy as np
from pydantic import ConfigDict, Field
from scipy import stats

from taxel.schema import Schema
from taxel_models.loop.effects.fault import Fault

NONE: Final = "none"
UNEXPLAINED: Final = "unexplained"
UNKNOWN_KIND: Final = "unknown:"
DYING: Final = "dying electrode"
"""The foreign cause of a channel that loses sensitivity; a fault may look like one."""

BOTH: Final = " + "
"""Between two causes of a round."""

LEVEL: Final = 0.95
"""Of the intervals of rates."""

POWER_EDGES: Final = (0.5, 2.0**-0.5, 1.0, 2.0**0.5, 2.0)
"""Strengths between which rates are counted together; the first and the last reach on."""


class Round(Schema):
    """One round.

    Attributes:
        truth: the injected cause, `none`, or `unknown:NAME`; two causes are joined by `BOTH`.
        strength: over the residual before.
        injected: the parameters of what was injected; `planted` in JSON.
        found: the effect that explains most, `none` where nothing was named, `unexplained` where
            nothing was named and what is left is structured.
        named: all that were named.
        right: whether the first is right, or nothing was named where there was nothing, or where no
            effect describes what there was.
        confounded: whether a right name was reported as one that cannot be told from a named one.
        clean: normalised MAE on the evaluation blocks without the injected effect.
        before: with it.
        after: with the correction.
        removed: share of the removable error that was removed; None where there was none to speak of.
        parameter_error: of the figure that is marked, relative; None where there is none.
        accepted: the names that are right, for each injected cause.
        all_named: whether each injected cause has a right name of its own among those named.
        changed: channels of which a line says that their sensitivity changed; None in older files.
        ground: `twin`, `slide` or `lasa`.
        injector: `own` or `foreign`.
        base_model: the number of the model, where several took turns.
    """

    model_config = ConfigDict(populate_by_name=True)

    number: int
    truth: str
    strength: float
    injected: Annotated[dict[str, Any], Field(alias="planted")]
    found: str
    named: tuple[str, ...]
    right: bool
    confounded: bool
    clean: float
    before: float
    after: float
    removed: float | None
    parameter_error: float | None
    accepted: tuple[tuple[str, ...], ...] = ()
    all_named: bool = False
    changed: tuple[str, ...] | None = None
    ground: str = "twin"
    injector: str = "own"
    base_model: int = 0

    @property
    def unknown(self) -> bool:
        """Whether the cause is one that no effect describes."""
        return self.truth.startswith(UNKNOWN_KIND)

    @property
    def nameable(self) -> bool:
        """Whether a cause was injected that has a name."""
        return self.truth != NONE and not self.unknown


class Rate(Schema):
    """A share of rounds with its Clopper-Pearson interval at 95 %."""

    hits: int
    rounds: int
    share: float
    low: float
    high: float


class Summary(Schema):
    """What the rounds come to.

    Attributes:
        confusion: for each truth, how often each effect was found first.
        right_first: share of the rounds with an injected effect in which it was found first.
        right_or_confounded: likewise, or was reported as one that cannot be told from it.
        false_alarms: share of the clean rounds in which anything was named.
        unknown_left: share of the rounds with an unknown cause in which nothing was named.
        removed: median share of the removable error that was removed where the effect was right.
        removed_mean: its mean, weighed by what there was to remove.
        parameters_within: share of the marked parameters within 20 %.
        rates: the shares above with intervals, and `all_named`: rounds in which each cause was named;
            `change_told`: of the rounds with one dying electrode, those with a line on it;
            `change_false`: of those in which no channel's sensitivity changed, those with such a line;
            `models_alarmed`: where several models took turns, those of which anything was named on a
            clean recording. Rounds of one model are alike: this interval is the honest one.
        power: for each cause and range of strengths, how often it was found first.
    """

    rounds: int
    confusion: dict[str, dict[str, int]]
    right_first: float | None
    right_or_confounded: float | None
    false_alarms: float | None
    unknown_left: float | None
    removed: float | None
    removed_mean: float | None
    parameters_within: float | None
    rates: dict[str, Rate] = Field(default_factory=dict)
    power: dict[str, dict[str, Rate]] = Field(default_factory=dict)


def summarise(rounds: Sequence[Round]) -> Summary:
    """Counts the rounds' outcomes."""
    confusion: dict[str, Counter[str]] = {}
    for finished in rounds:
        confusion.setdefault(finished.truth, Counter())[finished.found] += 1
    injected = [finished for finished in rounds if finished.nameable]
    right = [finished for finished in injected if finished.right]
    marked = [finished for finished in right if finished.removed is not None]
    weight = sum(finished.before - finished.clean for finished in marked)
    lines = [
        (finished, finished.changed)
        for finished in rounds
        if finished.changed is not None and BOTH not in finished.truth
    ]
    marks = {
        "right_first": [finished.right for finished in injected],
        "right_or_confounded": [finished.right or finished.confounded for finished in injected],
        "all_named": [finished.all_named for finished in injected],
        "false_alarms": [bool(finished.named) for finished in rounds if finished.truth == NONE],
        "unknown_left": [finished.right for finished in rounds if finished.unknown],
        "change_told": [
            finished.injected["channel"] in changed
            for finished, changed in lines
            if finished.truth.startswith(DYING)
        ],
        "change_false": [
            bool(changed)
            for finished, changed in lines
            if not finished.truth.startswith((DYING, Fault.name))
        ],
    }
    if any(finished.base_model for finished in rounds):
        marks["models_alarmed"] = _alarmed(rounds)
    rates = {name: rate(values) for name, values in marks.items() if values}
    shares = {name: found.share for name, found in rates.items()}
    return Summary(
        rounds=len(rounds),
        confusion={truth: dict(counts) for truth, counts in sorted(confusion.items())},
        right_first=shares.get("right_first"),
        right_or_confounded=shares.get("right_or_confounded"),
        false_alarms=shares.get("false_alarms"),
        unknown_left=shares.get("unknown_left"),
        removed=float(np.median([finished.removed for finished in marked])) if marked else None,
        removed_mean=sum(finished.before - finished.after for finished in marked) / weight
        if weight
        else None,
        parameters_within=_share(
            [finished.parameter_error <= 0.2 for finished in right if finished.parameter_error is not None]
        ),
        rates=rates,
        power=power(injected),
    )


def _alarmed(rounds: Sequence[Round]) -> list[bool]:
    """For each base model with clean rounds, whether anything was named in one of them."""
    clean = [finished for finished in rounds if finished.truth == NONE]
    alarmed = {finished.base_model for finished in clean if finished.named}
    return [model in alarmed for model in {finished.base_model for finished in clean}]


def rate(marks: Sequence[bool]) -> Rate:
    """Of at least one mark."""
    hits, rounds = sum(marks), len(marks)
    interval = stats.binomtest(hits, rounds).proportion_ci(LEVEL, method="exact")
    return Rate(
        hits=hits, rounds=rounds, share=hits / rounds, low=float(interval.low), high=float(interval.high)
    )


def power(injected: Sequence[Round]) -> dict[str, dict[str, Rate]]:
    """How often each cause was found first, by ranges of the strength such as `0.71 to 1`.

    Forms of a cause are counted together. Of two causes, each counts where it was named at all.
    """
    marks: dict[str, dict[str, list[bool]]] = {}
    for finished in sorted(injected, key=lambda one: one.strength):
        place = int(np.searchsorted(POWER_EDGES[1:-1], finished.strength, side="right"))
        name = range_name(POWER_EDGES[place], POWER_EDGES[place + 1])
        truths = finished.truth.split(BOTH)
        for number, truth in enumerate(truths):
            right = finished.right
            if len(truths) > 1:
                right = bool(set(finished.accepted[number]) & set(finished.named))
            marks.setdefault(truth.partition(": ")[0], {}).setdefault(name, []).append(right)
    return {
        cause: {name: rate(values) for name, values in own.items()} for cause, own in sorted(marks.items())
    }


def range_name(low: float, high: float) -> str:
    """What a range of strengths is called."""
    return f"{low:.2g} to {high:.2g}"


def _share(marks: Sequence[bool]) -> float | None:
    return sum(marks) / len(marks) if marks else None
