"""The errors of each channel before and after, and which share of the residual went where."""

from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from taxel.channels import CHANNELS
from taxel_models.loop.findings import Findings
from taxel_models.loop.report.drawing import AFTER, BEFORE, NOISE, STRUCTURE, Drawing
from taxel_models.loop.report.numbers import percent


def draw_channels(findings: Findings, noise: tuple[float, ...]) -> Drawing:
    """A pair of bars a channel, and the error that its noise alone would leave.

    Args:
        noise: (21,) normalised MAE of each channel's noise.
    """
    figure = Figure(figsize=(10, 3.8), layout="constrained")
    axes = figure.subplots()
    places = np.arange(len(CHANNELS))
    for shift, errors, colour, label in (
        (-0.2, findings.before, BEFORE, "before"),
        (0.2, findings.after, AFTER, "after"),
    ):
        heights = [errors["per_channel"][name]["norm_mae"] for name in CHANNELS]
        axes.bar(places + shift, heights, 0.4, color=colour, label=f"{label}: {errors['norm_mae']:.3f}")
    axes.hlines(noise, places - 0.42, places + 0.42, color="black", lw=1.6, label="noise alone")
    axes.set_xticks(places, CHANNELS)
    axes.set_ylabel("normalised MAE")
    axes.legend()
    axes.grid(axis="y", alpha=0.3)
    return figure, (
        "Normalised MAE of each channel on the evaluation part; the black line is what noise alone would "
        "leave."
    )


def draw_waterfall(findings: Findings) -> Drawing:
    """From the first residual's energy down to what is unexplained and what is noise."""
    drawn = parts_of(findings)
    figure = Figure(figsize=(9, 1.1 + 0.45 * len(drawn)), layout="constrained")
    axes = figure.subplots()
    for place, bar in enumerate(drawn):
        axes.barh(place, bar.stop - bar.start, left=bar.start, color=bar.colour, height=0.7)
        beside = (max(bar.start, bar.stop), place)
        axes.annotate(bar.text, beside, (4, 0), textcoords="offset points", va="center")
    axes.set_yticks(range(len(drawn)), [bar.label for bar in drawn])
    axes.invert_yaxis()
    ends = [end for bar in drawn for end in (bar.start, bar.stop)]
    axes.set_xlim(min(ends), max(ends) + 0.12)
    axes.xaxis.set_major_formatter(lambda share, _: f"{100 * share:.0f} %")
    axes.set_xlabel("energy of the residual, mean over the channels")
    axes.grid(axis="x", alpha=0.3)
    caption = "Where the residual's energy on the evaluation part goes, each effect beside those above it."
    return figure, caption


class Part(NamedTuple):
    """A part of the residual's energy, as a bar of the waterfall."""

    label: str
    start: float
    stop: float
    colour: str
    text: str


def parts_of(findings: Findings) -> list[Part]:
    """From the whole residual downwards; the last two make up what is left."""
    found, level = [Part("residual before", 0.0, 1.0, BEFORE, "100 %")], 1.0
    for effect in findings.effects:
        label = effect.name if effect.served else f"{effect.name}\n(only reported)"
        sign = "\N{MINUS SIGN}" if effect.explained >= 0 else "+"
        text = f"{sign}{percent(abs(effect.explained))}"
        found.append(Part(label, level - effect.explained, level, AFTER, text))
        level -= effect.explained
    noise = min(findings.noise_floor["share_of_residual_energy"], level)
    found.append(Part("unexplained structure", noise, level, STRUCTURE, percent(level - noise)))
    return [*found, Part("noise", 0.0, noise, NOISE, percent(noise))]
