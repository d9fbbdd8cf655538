"""What a report tells, in order, from findings and pictures."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

from taxel.channels import CHANNELS
from taxel.windows import ExtraFeature
from taxel_models.loop.findings import Findings, FoundEffect
from taxel_models.loop.report.document import Block, Document, Heading, Paragraph, Picture, Table
from taxel_models.loop.report.wording import (
    chance,
    interval,
    listed,
    minutes,
    needs,
    number,
    opening,
    percent,
)

_MOST_PARAMETERS: Final = 24
"""Rows of an effect's table: further figures are in `report.json`."""


@dataclass(frozen=True)
class Pictures:
    """The pictures of a report.

    Attributes:
        waterfall: explained shares.
        channels: errors of each channel.
        residual: spectrum and autocorrelation.
        effects: one each, by the effect's name.
    """

    waterfall: Picture
    channels: Picture
    residual: Picture
    effects: dict[str, Picture]


def contents(findings: Findings, extras: Sequence[ExtraFeature], pictures: Pictures) -> Document:
    """The whole report.

    Args:
        extras: what the corrected model takes beside its window.
    """
    blocks: list[Block] = [
        Paragraph(opening(findings, extras)),
        pictures.waterfall,
        *_confounding(findings),
    ]
    for effect in findings.effects:
        blocks += _effect(effect, extras, pictures.effects[effect.name])
    blocks += [
        *_next_recordings(findings),
        *_rejected(findings),
        *_unnamed(findings),
        Heading("What is left"),
        Paragraph(_left(findings)),
        pictures.residual,
    ]
    blocks += [Heading("Errors before and after"), pictures.channels, _errors(findings)]
    blocks += [Heading("Data and split"), *_data(findings)]
    return Document(f"What {findings.model} lacks", tuple(blocks))


def _confounding(findings: Findings) -> list[Block]:
    if not findings.confounding:
        return []
    shares = {(one.quantity, one.along): percent(one.share) for one in findings.confounding}
    along = sorted({one.along for one in findings.confounding})
    quantities = sorted({one.quantity for one in findings.confounding})
    rows = tuple((name, *(shares.get((name, other), "") for other in along)) for name in quantities)
    text = (
        "Before anything is fitted: the share of each quantity's variance over rows in contact that "
        "another one foretells. Where it is large, causes that depend on the two cannot be told apart."
    )
    return [Heading("What runs along with what"), Paragraph(text), Table(("quantity", *along), rows)]


def _effect(effect: FoundEffect, extras: Sequence[ExtraFeature], picture: Picture) -> list[Block]:
    test = f"{chance(effect.p_value)} over the folds; log odds {effect.log_evidence:,.0f}"
    explained = f"{percent(effect.explained)} of the residual's energy on the evaluation part ({test})"
    where = "all channels" if len(effect.channels) == len(CHANNELS) else listed(effect.channels)
    text = (
        f"{effect.equation}. Form: {effect.form}. It explains {explained} and changes {where}; without it, "
        f"{percent(effect.conditional)} would come back on the part that was fitted to. "
        f"It {needs(effect, extras)}."
    )
    return [Heading(f"{effect.name}"), Paragraph(text), picture, *_parameters(effect)]


def _parameters(effect: FoundEffect) -> list[Block]:
    figures = effect.parameters[:_MOST_PARAMETERS]
    rows = tuple(
        (figure.name, number(figure.value), interval(figure) or "settled", figure.unit)
        for figure in figures
    )
    blocks: list[Block] = [Table(("parameter", "value", "95 % interval", "unit"), rows)]
    more = len(effect.parameters) - len(figures)
    if more:
        blocks.append(Paragraph(f"{more} more parameters are in report.json."))
    return blocks if rows else []


def _next_recordings(findings: Findings) -> list[Block]:
    proposals = [one for one in findings.next_recordings if one.protocol is not None]
    if not proposals:
        return []
    rows = tuple(
        (
            listed(one.causes),
            one.protocol.name,
            one.protocol.about,
            minutes(one.duration_s),
            f"{one.right} of {one.simulated}",
            one.file,
        )
        for one in proposals
        if one.protocol is not None
    )
    text = (
        "Each protocol was simulated with either cause as it was fitted, and with noise drawn from what is "
        "left here. Of the protocols with the most right decisions, the shortest is shown. Only these two "
        "causes and a constant competed. `taxel twin --protocol FILE` plays a protocol on the twin."
    )
    head = ("causes", "protocol", "what to do", "takes", "right decisions", "file")
    return [Heading("What to record next"), Paragraph(text), Table(head, rows)]


def _rejected(findings: Findings) -> list[Block]:
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


def _unnamed(findings: Findings) -> list[Block]:
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


def _left(findings: Findings) -> str:
    unexplained = findings.unexplained
    kind = "structured but unexplained" if unexplained.structured else "as good as noise"
    share = f"{percent(unexplained.share)} of it is more than the channels' noise"
    lags = listed([f"{value:.2f} at {lag}" for lag, value in unexplained.autocorrelation.items()])
    return f"What is left is {kind}: {unexplained.hint}. {share}; its autocorrelation is {lags}."


def _errors(findings: Findings) -> Table:
    rows = [
        _error_row("all 21", findings.before, findings.after, ""),
        _error_row("electrodes", findings.before, findings.after, "_electrodes"),
    ]
    before, after = findings.before["per_channel"], findings.after["per_channel"]
    rows += [_error_row(name, before[name], after[name], "") for name in CHANNELS]
    head = ("channel", "MAE before, counts", "after", "normalised MAE before", "after")
    return Table(head, tuple(rows))


def _error_row(name: str, before: dict[str, Any], after: dict[str, Any], part: str) -> tuple[str, ...]:
    mae, norm = f"mae{part}", f"norm_mae{part}"
    counts = (f"{before[mae]:.2f}", f"{after[mae]:.2f}")
    return (name, *counts, f"{before[norm]:.3f}", f"{after[norm]:.3f}")


def _data(findings: Findings) -> list[Block]:
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
        Table(("recording", "format", "rows", "sha256"), rows),
        Paragraph(f"Split: {split}."),
        Paragraph(noise),
        Paragraph(f"Test: {findings.test.method}; t = {findings.test.t:.2f}."),
    ]
