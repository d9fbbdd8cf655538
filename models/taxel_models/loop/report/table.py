"""Findings as a table for the terminal."""

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from taxel_models.loop.findings import Findings
from taxel_models.loop.report.numbers import key_parameters, percent
from taxel_models.loop.report.wording import (
    anyway,
    beside_training,
    confounded,
    corrects,
    inverted,
    left,
    like_an_offset,
    new_kinds,
    next_recordings,
    no_reference,
    nothing_to_add,
    one_kind,
    paired,
    runs_along,
    unconfirmed_effects,
    unnamed,
)


def findings_table(findings: Findings) -> RenderableType:
    """The named effects, then lines on the error before and after and on what is left."""
    lines = [
        _errors(findings),
        *beside_training(findings),
        *anyway(findings),
        *no_reference(findings),
        *unconfirmed_effects(findings),
        *inverted(findings),
        *one_kind(findings),
        *new_kinds(findings),
        *confounded(findings),
        *like_an_offset(findings),
        *runs_along(findings),
        *next_recordings(findings),
        *findings.changes,
        *unnamed(findings),
        left(findings),
    ]
    text = Text("\n".join(lines))
    return Group(_effects(findings), text) if findings.effects else Group("No effect was named.", text)


def _effects(findings: Findings) -> Table:
    table = Table("effect", "form and parameters", "explained", "p", "cannot be told from")
    table.columns[2].justify = table.columns[3].justify = "right"
    # A narrow terminal must not cut a name.
    table.columns[0].no_wrap = True
    for effect in findings.effects:
        table.add_row(
            Text(effect.name if effect.served else f"{effect.name} (only reported)"),
            Text(effect.form + (f"\n{key_parameters(effect)}" if effect.parameters else "")),
            percent(effect.explained),
            f"{effect.p_value:.2g}",
            Text(", ".join(effect.confounded_with)),
        )
    return table


def _errors(findings: Findings) -> str:
    before, after = (f"{error['norm_mae']:.3f}" for error in (findings.before, findings.after))
    noise = f"(noise: {findings.noise_floor['norm_mae']:.3f})"
    if not corrects(findings):
        return f"Normalised MAE {before} {noise}. {nothing_to_add(findings)}"
    return f"Normalised MAE {before} before, {after} after {noise}; {paired(findings.test)}."
