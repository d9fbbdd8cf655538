"""What a report tells, in order, from findings and pictures."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from taxel.channels import CHANNELS
from taxel.windows import ExtraFeature
from taxel_models.loop.findings import Findings, FoundEffect
from taxel_models.loop.report.correlation_pictures import outside, strongest
from taxel_models.loop.report.document import (
    Block,
    Document,
    Folded,
    Heading,
    Note,
    Paragraph,
    Picture,
    Table,
)
from taxel_models.loop.report.numbers import (
    chance,
    interval,
    key_parameters,
    listed,
    minutes,
    needs,
    number,
    percent,
)
from taxel_models.loop.report.wording import (
    confounded,
    headline,
    inverted,
    looks_wrong,
    new_kinds,
    no_reference,
    opening,
    unconfirmed_effects,
)

_MOST_OPEN: Final = 6
"""A longer table of parameters folds away."""

_MOST_PAIRS: Final = 8
_CORRELATED: Final = 0.5
"""Weaker correlations between parameters get no line."""

EFFECT: Final = "effect: "
"""Begins the key of an effect's picture."""


@dataclass(frozen=True)
class Told:
    """What a section can tell from.

    Attributes:
        findings: all.
        extras: what the corrected model takes beside its window.
        pictures: by key; a picture that these findings have no use for is missing.
    """

    findings: Findings
    extras: Sequence[ExtraFeature]
    pictures: Mapping[str, Picture]

    def picture(self, key: str) -> list[Block]:
        """The picture, if there is one."""
        return [self.pictures[key]] if key in self.pictures else []


def contents(told: Told) -> Document:
    """The whole report."""
    blocks = [block for section in SECTIONS for block in section(told)]
    return Document(f"What {told.findings.model} lacks", tuple(blocks))


def _first_screen(told: Told) -> list[Block]:
    """One sentence, what to heed and the channels that changed, one picture, one table."""
    findings = told.findings
    lines = (
        *looks_wrong(findings),
        *no_reference(findings),
        *new_kinds(findings),
        *unconfirmed_effects(findings),
        *inverted(findings),
        *findings.changes,
    )
    changed: list[Block] = [Note(lines)] if lines else []
    table = _effects_table(findings) if findings.effects else _nearest_table(findings)
    return [Paragraph(headline(findings)), *changed, *told.picture("waterfall"), *table]


def _effects_table(findings: Findings) -> list[Block]:
    rows = tuple(
        (
            effect.name if effect.served else f"{effect.name} (only reported)",
            percent(effect.explained),
            chance(effect.p_value),
            on_halves(findings, effect.name),
            key_parameters(effect),
            ", ".join(effect.confounded_with) or "\N{EN DASH}",
        )
        for effect in findings.effects
    )
    head = ("effect", "explains", "chance", "on halves", "parameters", "cannot be told from")
    return [Table(head, rows)]


def _nearest_table(findings: Findings) -> list[Block]:
    tried = [one for one in findings.rejected if one.form]
    rows = tuple((one.name, percent(one.alone), one.reason) for one in tried[:3])
    return [Table(("nearest candidate", "alone", "why not"), rows)] if rows else []


def on_halves(findings: Findings, name: str) -> str:
    """How often an effect was named on random halves."""
    if findings.stability is None:
        return "not tried"
    halves = findings.stability.halves
    return f"{round(findings.stability.chosen.get(name, 0.0) * halves)} of {halves}"


def _in_words(told: Told) -> list[Block]:
    return [Heading("In words"), Paragraph(opening(told.findings, told.extras))]


def _session(told: Told) -> list[Block]:
    return [Heading("Contacts and the session"), *told.picture("traces"), *told.picture("session")]


def _effects(told: Told) -> list[Block]:
    return [block for effect in told.findings.effects for block in _effect(told, effect)]


def _effect(told: Told, effect: FoundEffect) -> list[Block]:
    test = f"{chance(effect.p_value)} over the folds; log odds {effect.log_evidence:,.0f}"
    explained = f"{percent(effect.explained)} of the residual's energy on the evaluation part ({test})"
    where = "all channels" if len(effect.channels) == len(CHANNELS) else listed(effect.channels)
    text = (
        f"{effect.equation}. Form: {effect.form}. It explains {explained} and changes {where}; without it, "
        f"{percent(effect.conditional)} would come back on the part that was fitted to. "
        f"It {needs(effect, told.extras)}."
    )
    picture = told.picture(EFFECT + effect.name)
    return [Heading(f"{effect.name}"), Paragraph(text), *picture, *_parameters(effect)]


def _parameters(effect: FoundEffect) -> list[Block]:
    rows = tuple(
        (figure.name, number(figure.value), interval(figure) or "not estimated", figure.unit)
        for figure in effect.parameters
    )
    table = Table(("parameter", "value", "95 % interval", "unit"), rows)
    if len(rows) > _MOST_OPEN:
        return [Folded(f"{len(rows)} parameters with their intervals", (table,))]
    return [table] if rows else []


def _confounded(told: Told) -> list[Block]:
    """What the recording tells only together: effects, and parameters."""
    blocks: list[Block] = []
    if sentences := confounded(told.findings):
        blocks += [Heading("What cannot be told apart"), Paragraph(" ".join(sentences))]
        blocks += told.picture("confounded")
    found = told.findings.parameter_correlation
    if found is None:
        return blocks
    matrix = np.array(found.matrix)
    pairs = sorted(zip(*np.triu_indices(len(matrix), 1), strict=True), key=lambda at: -abs(matrix[at]))
    strong = [at for at in pairs if abs(matrix[at]) >= _CORRELATED]
    rows = tuple(
        (found.parameters[first], found.parameters[second], f"{matrix[first, second]:.2f}")
        for first, second in strong[:_MOST_PAIRS]
    )
    blocks += [Heading("Correlations between parameters"), *told.picture("parameters")]
    return [*blocks, Table(("parameter", "with", "correlation"), rows)] if rows else blocks


def _stability(told: Told) -> list[Block]:
    found = told.findings.stability
    if found is None:
        return []
    named = [effect.name for effect in told.findings.effects]
    others = [f"{name} {on_halves(told.findings, name)}" for name in found.chosen if name not in named]
    rows = tuple((name, on_halves(told.findings, name)) for name in named)
    text = (
        f"Effects were named anew on {found.halves} random halves of the fit part's blocks. With half the "
        "blocks, a weak effect is named less often. "
        f"{f'Named there alone: {listed(others)}.' if others else 'No other effect was named there.'}"
    )
    if never := [name for name in named if not found.chosen.get(name)]:
        text += f" On none of them: {listed(never)}. Only a longer recording would show it on halves, too."
    table: list[Block] = [Table(("effect", "named on"), rows)] if rows else []
    return [Heading("How often each effect is chosen"), Paragraph(text), *table]


def _confounding(told: Told) -> list[Block]:
    findings = told.findings
    if not findings.confounding:
        return []
    shares = {(one.quantity, one.along): percent(one.share) for one in findings.confounding}
    along = sorted({one.along for one in findings.confounding})
    quantities = sorted({one.quantity for one in findings.confounding})
    rows = tuple((name, *(shares.get((name, other), "") for other in along)) for name in quantities)
    text = (
        "Before anything is fitted: the share of each quantity's variance over rows in contact that "
        "another one predicts. Where it is large, causes that depend on the two cannot be told apart."
    )
    return [Heading("What runs along with what"), Paragraph(text), Table(("quantity", *along), rows)]


def _next_recordings(told: Told) -> list[Block]:
    findings = told.findings
    rows = tuple(
        (
            listed(one.causes),
            one.protocol.name,
            one.protocol.about,
            minutes(one.duration_s),
            f"{one.right} of {one.simulated}",
            one.file,
        )
        for one in findings.next_recordings
        if one.protocol is not None
    )
    if not rows:
        return []
    text = (
        "Each protocol was simulated with either cause as it was fitted, and with noise drawn from what is "
        "left here. Of the protocols with the most right decisions, the shortest is shown. Only these two "
        "causes and a constant competed. `taxel twin --protocol FILE` plays a protocol on the twin."
    )
    head = ("causes", "protocol", "what to do", "takes", "right decisions", "file")
    return [Heading("What to record next"), Paragraph(text), Table(head, rows)]


def _unnamed(told: Told) -> list[Block]:
    findings = told.findings
    found = findings.residual_model
    if found is None:
        return []
    rows = tuple(
        (gain.channel, f"{gain.folds:.4f}", f"{gain.error:.4f}", f"{gain.evaluation:.4f}")
        for gain in found.channels
    )
    text = (
        f"{found.about[0].upper()}{found.about[1:]}. It says nothing of causes. A channel has it if "
        "its error falls on held-out folds. Figures are falls of the normalised MAE beyond what the named "
        "effects bring. "
        f"Beside the window it needs {listed(found.needs) if found.needs else 'nothing'}."
    )
    head = ("channel", "on held-out folds", "standard error", "on the evaluation part")
    return [Heading("Unnamed: a residual model"), Paragraph(text), Table(head, rows)]


def _rejected(told: Told) -> list[Block]:
    findings = told.findings
    if not findings.rejected:
        return []
    rows = tuple(
        (
            candidate.name,
            candidate.form,
            percent(candidate.alone),
            percent(candidate.left),
            f"{candidate.log_evidence:,.0f}",
            candidate.reason,
        )
        for candidate in findings.rejected
    )
    text = (
        "Shares are what the candidate explains of the first residual on held-out folds, by itself and "
        "beside the named effects, less what it explains of the model's own held-out residual; below 0 it "
        "would do harm."
    )
    head = ("candidate", "likeliest form", "alone", "beside the named", "log odds", "why not")
    return [Heading("Rejected"), Paragraph(text), Table(head, rows)]


def _left(told: Told) -> list[Block]:
    unexplained = told.findings.unexplained
    kind = "structured but unexplained" if unexplained.structured else "as good as noise"
    share = f"{percent(unexplained.share)} of it is more than the channels' noise"
    lags = listed([f"{value:.2f} at {lag}" for lag, value in unexplained.autocorrelation.items()])
    text = f"What is left is {kind}: {unexplained.hint}. {share}; its autocorrelation is {lags}."
    pictures = [*told.picture("residual"), *told.picture("autocorrelation"), *told.picture("inputs")]
    return [Heading("What is left"), Paragraph(text), *pictures, *_inputs(told.findings)]


def _inputs(findings: Findings) -> list[Block]:
    """The channel that depends on each input most, and how many do."""
    rows = []
    for one in findings.cross_correlation:
        cells = [one.input]
        for values, bands in ((one.before, one.band_before), (one.after, one.band_after)):
            channel, lag, value = strongest(values, bands)
            band = f"band \N{PLUS-MINUS SIGN}{bands[channel]:.2f}"
            cells += [f"{value:.2f} in {channel} at {one.lags_s[lag]:g} s ({band})"]
            cells += [str(len(outside(values, bands)))]
        rows.append(tuple(cells))
    head = ("input", "largest before", "channels outside", "largest after", "channels outside")
    return [Table(head, tuple(rows))] if rows else []


def _errors(told: Told) -> list[Block]:
    findings = told.findings
    rows = [
        _error_row("all 21", findings.before, findings.after, ""),
        _error_row("electrodes", findings.before, findings.after, "_electrodes"),
    ]
    before, after = findings.before["per_channel"], findings.after["per_channel"]
    rows += [_error_row(name, before[name], after[name], "") for name in CHANNELS]
    head = ("channel", "MAE before, counts", "after", "normalised MAE before", "after")
    return [Heading("Errors before and after"), *told.picture("channels"), Table(head, tuple(rows))]


def _error_row(name: str, before: dict[str, Any], after: dict[str, Any], part: str) -> tuple[str, ...]:
    mae, norm = f"mae{part}", f"norm_mae{part}"
    counts = (f"{before[mae]:.2f}", f"{after[mae]:.2f}")
    return (name, *counts, f"{before[norm]:.3f}", f"{after[norm]:.3f}")


def _data(told: Told) -> list[Block]:
    findings = told.findings
    rows = tuple(
        (
            str(recording["name"]),
            str(recording["format"]),
            str(recording["rows"]),
            str(recording["sha256"])[:12],
        )
        for recording in findings.data
    )
    split = "; ".join(f"{name.replace('_', ' ')}: {value}" for name, value in findings.split.items())
    noise = (
        f"Noise floor: {findings.noise_floor['method']}; {findings.noise_floor['mae']:.2f} counts MAE, "
        f"{percent(findings.noise_floor['share_of_residual_energy'])} of the residual's energy."
    )
    return [
        Heading("Data and split"),
        Table(("recording", "format", "rows", "sha256"), rows),
        Paragraph(f"Split: {split}."),
        Paragraph(noise),
        Paragraph(f"Test: {findings.test.method}; t = {findings.test.t:.2f}."),
    ]


SECTIONS: Final[tuple[Callable[[Told], list[Block]], ...]] = (
    _first_screen,
    _in_words,
    _session,
    _confounding,
    _effects,
    _confounded,
    _next_recordings,
    _stability,
    _rejected,
    _unnamed,
    _left,
    _errors,
    _data,
)
"""In order. A section with nothing to tell is empty."""
