"""What the loop found, as a folder.

DIR/report.json            the findings; their schema is `taxel_models.loop.findings`
DIR/report.md              the same to read, with the pictures beside it
DIR/report.html            the same in one file
DIR/waterfall.png          where the residual's energy goes
DIR/traces.png             measured, predicted and corrected counts of a typical and of the worst block
DIR/session.png            the residual of each channel over the session
DIR/confounded.png         effects that cannot be told apart
DIR/parameters.png         correlations between parameters
DIR/channels.png           each channel's error before and after
DIR/residual.png           the residual's spectrum before and after
DIR/autocorrelation.png    its autocorrelation
DIR/inputs.png             its correlation with each input
DIR/next-1-NAMES.json …    what to record where two causes cannot be told apart; for `taxel twin --protocol`
DIR/effect-1-NAME.png …    the residual against each named effect's driver before and after
"""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np

from taxel.atomic import whole_folder
from taxel.channels import CHANNELS
from taxel_models.loop.pipeline import LoopResult
from taxel_models.loop.report.confounded_picture import draw_confounded
from taxel_models.loop.report.contents import EFFECT, Told, contents
from taxel_models.loop.report.correlation_pictures import (
    draw_autocorrelation,
    draw_cross_correlation,
    draw_parameter_correlation,
)
from taxel_models.loop.report.document import Picture
from taxel_models.loop.report.drawing import Drawing
from taxel_models.loop.report.effect_pictures import draw_effect
from taxel_models.loop.report.error_pictures import draw_channels, draw_waterfall
from taxel_models.loop.report.partial import Partial
from taxel_models.loop.report.rendering import html, markdown
from taxel_models.loop.report.residual_picture import draw_spectrum
from taxel_models.loop.report.session_pictures import draw_session, draw_traces

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
        document = contents(Told(findings, result.new.extras, _draw(result, place)))
        (place / "report.md").write_text(markdown(document), encoding="utf-8")
        (place / "report.html").write_text(html(document, place), encoding="utf-8")


def _draw(result: LoopResult, place: Path) -> dict[str, Picture]:
    """Every picture that these findings have a use for, by its key, saved in a folder."""
    pictures = {key: _saved(place / f"{key}.png", title, drawn) for key, title, drawn in _drawings(result)}
    named = {effect.name: effect for effect in result.attribution.named}
    for number, effect in enumerate(result.findings.effects, 1):
        file = f"effect-{number}-{re.sub('[^A-Za-z0-9]+', '-', effect.name)}.png"
        drawn = draw_effect(result, Partial.of(result, named[effect.name]))
        title = f"{effect.name}: residual before and after"
        pictures[EFFECT + effect.name] = _saved(place / file, title, drawn)
    return pictures


def _saved(path: Path, title: str, drawn: Drawing) -> Picture:
    figure, caption = drawn
    figure.savefig(path, dpi=110, format="png")
    return Picture(path.name, title, caption)


def _drawings(result: LoopResult) -> Iterator[tuple[str, str, Drawing]]:
    """Key, title and drawing of the pictures of all effects together."""
    findings = result.findings
    yield "waterfall", "explained shares", draw_waterfall(findings)
    yield "traces", "traces of a typical and of the worst block", draw_traces(result)
    yield "session", "residual over the session", draw_session(result)
    yield "channels", "errors of each channel", draw_channels(findings, _noise(result))
    yield "residual", "spectrum of the residual", draw_spectrum(result)
    if findings.autocorrelation is not None:
        yield "autocorrelation", "autocorrelation", draw_autocorrelation(findings.autocorrelation)
    if findings.cross_correlation:
        yield "inputs", "correlation with the inputs", draw_cross_correlation(findings.cross_correlation)
    if (weights := findings.parameter_correlation) is not None:
        yield "parameters", "correlations between parameters", draw_parameter_correlation(weights)
    if any(effect.confounded_with for effect in findings.effects):
        yield "confounded", "effects that cannot be told apart", draw_confounded(findings)


def _noise(result: LoopResult) -> tuple[float, ...]:
    """(21,) normalised MAE of each channel's noise, taken as normal."""
    channels = result.findings.noise_floor["per_channel"]
    output_std = result.observations.manifest.normalisation.output_std
    return tuple(
        float(np.sqrt(2 / np.pi) * channels[name]["sd"] / std)
        for name, std in zip(CHANNELS, output_std, strict=True)
    )
