"""Findings in words: the sentences that a report opens with."""

import statistics
from collections.abc import Sequence
from typing import Final

from taxel.windows import ExtraFeature
from taxel_models.loop.attribution import AS_USUAL
from taxel_models.loop.confounding import CONSTANT
from taxel_models.loop.effects.gain import Gain
from taxel_models.loop.effects.offset import Offset
from taxel_models.loop.findings import Findings, PairedTest
from taxel_models.loop.report.numbers import (
    HARMFUL,
    chance,
    key_parameters,
    listed,
    minutes,
    needs,
    percent,
)

SIGNIFICANT: Final = 0.05
"""Of the paired test: above, the error is not said to have fallen."""

RUNS_ALONG: Final = 0.5
"""A quantity runs along with another that predicts this share of its variance."""

MOSTLY_CONSTANT: Final = 0.75
"""What has this share of a constant would look like an offset."""

_MOST_PAIRS: Final = 4

_STANDS_OUT: Final = 1.5
"""A channel whose error rose by so many times as much as that of most is told."""

_MOST_CHANNELS: Final = 3

_MUCH: Final = 0.1
"""An effect that would take off such a share by itself, beyond what is usual, is told with its form."""


def headline(findings: Findings) -> str:
    """The whole report in one sentence."""
    before, after = findings.before["norm_mae"], findings.after["norm_mae"]
    noise = f"noise alone would leave {findings.noise_floor['norm_mae']:.3f}"
    is_off = f"{findings.model} is off by a normalised MAE of {before:.3f} on held-out blocks"
    added = [effect.name for effect in findings.effects if effect.served]
    added += [] if findings.residual_model is None else ["a residual model"]
    told = [effect.name for effect in findings.effects if not effect.served]
    found = "" if findings.effects else ", and no effect was named"
    if told:
        found = f", and {listed(told)} {'was' if len(told) == 1 else 'were'} found, which no model can add"
    if not added:
        return f"{is_off} ({noise}){found}."
    change = f"{percent(abs(1.0 - after / before))} {'less' if after <= before else 'more'}"
    if findings.test.high >= 0 and findings.test.p_value > SIGNIFICANT:
        change += ", which may be chance"
    return f"{is_off}; with {listed(added)} added it is off by {after:.3f}, {change} ({noise}){found}."


def opening(findings: Findings, extras: Sequence[ExtraFeature]) -> str:
    """One paragraph that a reader can act on."""
    sentences = [
        _outcome(findings),
        *beside_training(findings),
        *_named(findings, extras),
        *unconfirmed_effects(findings),
        *inverted(findings),
        *one_kind(findings),
        *new_kinds(findings),
        *confounded(findings),
        *like_an_offset(findings),
        *runs_along(findings),
        *next_recordings(findings),
        _rejected(findings),
        *unnamed(findings),
        left(findings),
        _next(findings),
    ]
    return " ".join(filter(None, sentences))


def corrects(findings: Findings) -> bool:
    """Whether anything was found that a model can have."""
    return findings.residual_model is not None or any(effect.served for effect in findings.effects)


def nothing_to_add(findings: Findings) -> str:
    """Where nothing was found that a model can have."""
    if findings.effects:
        return "None of this can be added to the model."
    if findings.changes or any(one.reason == AS_USUAL and one.alone >= _MUCH for one in findings.rejected):
        return "Nothing proves itself that could be added to the model."
    return "Nothing was found that the model lacks."


def unnamed(findings: Findings) -> list[str]:
    """A sentence on the residual model, if there is one."""
    found = findings.residual_model
    if found is None:
        return []
    return [
        "A residual model without a name predicts a part of what no cause explains in "
        f"{len(found.channels)} channels: the normalised MAE {'falls' if found.gain >= 0 else 'rises'} by "
        f"{abs(found.gain):.4f} more on the evaluation part."
    ]


def _outcome(findings: Findings) -> str:
    before, after, test = findings.before, findings.after, findings.test
    where = f"On {test.blocks} held-out blocks ({before['rows']} rows)"
    is_off = f"{where}, {findings.model} is off by a normalised MAE of {before['norm_mae']:.3f}"
    noise = f"noise alone would leave {findings.noise_floor['norm_mae']:.3f}"
    if not corrects(findings):
        return f"{is_off} ({before['mae']:.1f} counts); {noise}."
    change = 1.0 - after["norm_mae"] / before["norm_mae"]
    fell = f"{percent(abs(change))} {'less' if change >= 0 else 'more'}"
    corrected = f"by {after['norm_mae']:.3f} ({after['mae']:.1f} counts) once corrected"
    return (
        f"{is_off} ({before['mae']:.1f} counts), and {corrected}: {fell}; {noise}. "
        f"Block by block, {paired(test)}."
    )


def beside_training(findings: Findings) -> list[str]:
    """How the model's error compares with that in training, as a sentence; none where that is not known."""
    ratios = findings.error_ratio
    if not ratios:
        return []
    median = statistics.median(ratios.values())
    above = sorted(
        ((ratio, name) for name, ratio in ratios.items() if ratio > _STANDS_OUT * max(median, 1.0)),
        reverse=True,
    )
    most = listed([f"{name} {ratio:.1f} times" for ratio, name in above[:_MOST_CHANNELS]])
    return [
        f"The RMS residual of the model is {median:.1f} times that on recordings that its training held "
        f"out (median of the channels{f'; {most}' if above else ''})."
    ]


def paired(test: PairedTest) -> str:
    """The paired test as half a sentence."""
    if test.high < 0:
        # The test asks whether the error falls: here, its p-value would only say that it does not.
        return (
            f"the error rises by {-test.difference:.4f} (95 % interval {-test.high:.4f} to {-test.low:.4f})"
        )
    sure = f"95 % interval {test.low:.4f} to {test.high:.4f}, {chance(test.p_value)}"
    verb = "falls" if test.difference >= 0 else "rises"
    fall = f"the error {verb} by {abs(test.difference):.4f} ({sure})"
    return fall if test.p_value <= SIGNIFICANT else f"{fall}, which may be chance"


def one_kind(findings: Findings) -> list[str]:
    """What a recording of one kind cannot tell, as a sentence; none where there is no such column."""
    if not findings.one_kind or not findings.effects:
        return []
    return [
        f"All rows have the same {listed(findings.one_kind)}. The model's own error is known for several "
        "together: what is named here may be its error on this one."
    ]


def new_kinds(findings: Findings) -> list[str]:
    """What the model was not trained on, a sentence for each column."""
    return [
        f"The model was not trained on {one.column} {listed([f'{value:g}' for value in one.values])} "
        f"({percent(one.share)} of the rows): it is wrong there in ways of its own, and only what goes "
        "clearly beyond is named."
        for one in findings.new_kinds
    ]


def anyway(findings: Findings) -> list[str]:
    """What the model got wrong from the start, as a sentence; none where there is no such effect."""
    usual = [one for one in findings.rejected if one.reason == AS_USUAL]
    usual.sort(key=lambda one: -one.alone)
    names = [
        f"{one.name} ({one.form}, {percent(one.alone)} by itself)" if one.alone >= _MUCH else one.name
        for one in usual
    ]
    if not names:
        return []
    return [
        f"{listed(names)} may be there, but cannot be told from what the model itself gets wrong, as its "
        f"training recordings tell: --no-reference looks for {'it' if len(names) == 1 else 'them'}, too."
    ]


def no_reference(findings: Findings) -> list[str]:
    """That the named effects may be the model's own, as a sentence; none where its own error is known."""
    if not findings.effects or findings.split.get("reference_rows") != 0:
        return []
    return [
        f"What {findings.model} gets wrong anyway is not known: its training held out less than 20 s, or "
        "its manifest does not say it. What is named may be its own misfit, and not a change of the sensor."
    ]


def _named(findings: Findings, extras: Sequence[ExtraFeature]) -> list[str]:
    if not findings.effects:
        return ["No effect was named: none proves itself on held-out blocks.", *anyway(findings)]
    count = len(findings.effects)
    sentences = [
        f"{count} effects were named, each beside those before it."
        if count > 1
        else "One effect was named."
    ]
    for effect in findings.effects:
        sentences.append(
            f"{effect.name} explains {percent(effect.explained)} of the residual's energy "
            f"({chance(effect.p_value)}; {key_parameters(effect)}) and {needs(effect, extras)}."
        )
    return sentences


def unconfirmed_effects(findings: Findings) -> list[str]:
    """A sentence for each named effect that takes nothing off the error of held-out blocks."""
    sentences = []
    for place, effect in enumerate(findings.effects):
        below = findings.effects[place + 1 :]
        other = next((one.name for one in below if one.explained >= -effect.explained), None)
        raises = (
            f"{effect.name} raises the squared error on held-out blocks, by {percent(-effect.explained)}"
        )
        if effect.explained < -HARMFUL and other is not None:
            sentences.append(
                f"{raises}, and {other} takes that off again: they cancel in part, and neither tells a "
                f"cause by itself. Leave one out and compare: --exclude {other}."
            )
        elif effect.explained < -HARMFUL and effect.served:
            sentences.append(
                f"{raises}: the blocks that it was fitted to do not show how it goes on there. Record "
                f"more, or leave it out: --exclude {effect.name}."
            )
        elif effect.explained < -HARMFUL:
            sentences.append(f"{raises}: something else may stand behind it. Do not act on it.")
        elif effect.explained <= 0.0:
            sentences.append(
                f"{effect.name} takes nothing off the squared error on held-out blocks, beside what stands "
                "above it."
            )
    return sentences


def inverted(findings: Findings) -> list[str]:
    """A sentence on channels whose gain turns their signal round; none where none does."""
    names = [
        figure.name.removeprefix("gain ")
        for effect in findings.effects
        if effect.name == Gain.name
        for figure in effect.parameters
        if figure.name.startswith("gain ") and figure.high is not None and figure.high < -1.0
    ]
    return [f"The signal of {listed(names)} has the wrong sign."] if names else []


def looks_wrong(findings: Findings) -> list[str]:
    """A sentence for each thing that looks wrong in the recordings."""
    return [f"What looks wrong in the recordings: {text}." for text in findings.looks_wrong]


def confounded(findings: Findings) -> list[str]:
    """A sentence for each named effect that others could stand for."""
    sentences, told = [], set[frozenset[str]]()
    for effect in findings.effects:
        others = [name for name in effect.confounded_with if frozenset({effect.name, name}) not in told]
        told |= {frozenset({effect.name, name}) for name in others}
        if len(others) == 1:
            sentences.append(
                f"{effect.name} and {others[0]} cannot be told apart here: they move together."
            )
        elif others:
            sentences.append(
                f"{effect.name} cannot be told apart here from {listed(others)}: they move together."
            )
    return sentences


def like_an_offset(findings: Findings) -> list[str]:
    """A sentence on what would look mostly like an offset in these recordings, where one is named."""
    if not any(effect.name == Offset.name for effect in findings.effects):
        return []
    told = [
        f"{one.quantity} ({percent(one.share)} of it is constant)"
        for one in findings.confounding
        if one.along == CONSTANT and one.share >= MOSTLY_CONSTANT
    ]
    return [f"In these recordings, {listed(told)} would look mostly like an offset, too."] if told else []


def runs_along(findings: Findings) -> list[str]:
    """A sentence on what runs along with something else, so that no fit could separate the two."""
    told: dict[frozenset[str], str] = {}
    for one in sorted(findings.confounding, key=lambda one: -one.share):
        if one.share >= RUNS_ALONG and one.along != CONSTANT:
            pair = frozenset({one.quantity, one.along})
            told.setdefault(pair, f"{one.quantity} with {one.along} ({percent(one.share)})")
    if not told:
        return []
    shown, more = [*told.values()][:_MOST_PAIRS], len(told) - _MOST_PAIRS
    if more > 0:
        shown.append(f"{more} more")
    return [f"In these recordings some things run along with others: {listed(shown)}."]


def next_recordings(findings: Findings) -> list[str]:
    """A sentence for each pair of causes that cannot be told apart: what to record."""
    sentences = []
    for one in findings.next_recordings:
        first, second = one.causes
        if one.protocol is None:
            sentences.append(
                f"None of the known protocols tells {first} from {second} reliably."
                if one.can_be_simulated
                else f"What would tell {first} from {second} cannot be worked out: what one of the two did "
                "here does not say what it would do in another recording."
            )
        else:
            sentences.append(
                f'To tell {first} from {second}, record "{one.protocol.name}" '
                f"({minutes(one.duration_s)}; {one.file}): the loop then decides rightly in {one.right} of "
                f"{one.simulated} simulated recordings."
            )
    return sentences


def _rejected(findings: Findings) -> str:
    count = len(findings.rejected)
    if not count:
        return ""
    were = "other candidate was" if count == 1 else "other candidates were"
    return f"{count} {were} rejected, for the reasons in the table below."


def left(findings: Findings) -> str:
    """What the named effects leave, in a sentence."""
    unexplained = findings.unexplained
    if not unexplained.structured:
        return "What is left is indistinguishable from the channels' noise."
    share = f"{percent(unexplained.share)} of it is not noise"
    return f"What is left is structured but unexplained ({share}): {unexplained.hint}."


def _next(findings: Findings) -> str:
    if findings.exported is not None:
        return f"The corrected model is {findings.exported}."
    if not corrects(findings):
        return nothing_to_add(findings)
    if findings.raises_the_error:
        return "Adding this to the model would make it worse on these recordings: it is not exported."
    if findings.test.p_value > SIGNIFICANT:
        return "Adding this to the model is not worth it on these recordings."
    return "Nothing was exported yet."
