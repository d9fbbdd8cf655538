"""What the loop found, as a folder.

DIR/report.json          the findings; their schema is `taxel_models.loop.findings`
DIR/report.md            the same to read, with the pictures beside it
DIR/report.html          the same in one file
DIR/waterfall.png        where the residual's energy goes
DIR/channels.png         each channel's error before and after
DIR/residual.png         the residual's spectrum and autocorrelation before and after
DIR/next-1-NAMES.json …  what to record where two causes cannot be told apart; for `taxel twin --protocol`
DIR/effect-1-NAME.png …  the residual against each named effect's driver before and after
"""

import re
from pathlib import Path
from typing import Final

import numpy as np

from taxel.atomic import whole_folder
from taxel.channels import CHANNELS
from taxel_models.loop.pipeline import LoopResult
from taxel_models.loop.report.contents import Pictures, contents
from taxel_models.loop.report.document import Picture
from taxel_models.loop.report.effect_pictures import draw_effect
from taxel_models.loop.report.error_pictures import draw_channels, draw_waterfall
from taxel_models.loop.report.partial import Partial
from taxel_models.loop.report.rendering import html, markdown
from taxel_models.loop.report.residual_picture import draw_residual

REPORT: Final = "report.json"
"""Marks a folder as a report, which a later one may replace."""


def write_report(folder: Path, result: LoopResult) -> None:
    """Write everything; an earlier report is replaced.

    Raises:
        SettingsError: something else than a report stands at `folder`.
    """
    findings = result.findings
    with whole_folder(folder, replacing=REPORT) as place:
        (place / REPORT).write_text(findings.model_dump_json(indent=1) + "\n", encoding="utf-8")
        for proposal in findings.next_recordings:
            if proposal.protocol is not None:
                text = proposal.protocol.model_dump_json(indent=1) + "\n"
                (place / proposal.file).write_text(text, encoding="utf-8")
        document = contents(findings, result.new.extras, _draw(result, place))
        (place / "report.md").write_text(markdown(document), encoding="utf-8")
        (place / "report.html").write_text(html(document, place), encoding="utf-8")


def _draw(result: LoopResult, place: Path) -> Pictures:
    findings = result.findings
    waterfall, channels, residual = "waterfall.png", "channels.png", "residual.png"
    named = {effect.name: effect for effect in result.attribution.named}
    effects = {}
    for number, effect in enumerate(findings.effects, 1):
        file = f"effect-{number}-{re.sub('[^A-Za-z0-9]+', '-', effect.name)}.png"
        partial = Partial.of(result, named[effect.name])
        title = f"{effect.name}: residual before and after"
        effects[effect.name] = Picture(file, title, draw_effect(result, partial, place / file))
    return Pictures(
        Picture(waterfall, "explained shares", draw_waterfall(findings, place / waterfall)),
        Picture(
            channels, "errors of each channel", draw_channels(findings, _noise(result), place / channels)
        ),
        Picture(residual, "spectrum and autocorrelation", draw_residual(result, place / residual)),
        effects,
    )


def _noise(result: LoopResult) -> tuple[float, ...]:
    """(21,) normalised MAE of each channel's noise, taken as normal."""
    channels = result.findings.noise_floor["per_channel"]
    output_std = result.observations.manifest.normalisation.output_std
    return tuple(
        float(np.sqrt(2 / np.pi) * channels[name]["sd"] / std)
        for name, std in zip(CHANNELS, output_std, strict=True)
    )
