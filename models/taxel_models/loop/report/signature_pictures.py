"""Pictures of effects that no driver shows: interference by its line, contact offsets by their scatter."""

from typing import Final

import numpy as np
from matplotlib.figure import Figure

from taxel.channels import CHANNELS
from taxel_models.loop.inference.contact_offset import CALIBRATIONS_S, calibrated
from taxel_models.loop.observations import runs
from taxel_models.loop.pipeline import LoopResult
from taxel_models.loop.report.drawing import AFTER, BEFORE, NOISE, Drawing
from taxel_models.loop.report.partial import Partial
from taxel_models.loop.spectrum import power_density, stretches

_LONGEST: Final = 512
"""Rows of a piece of the spectrum: 5 s."""


def draw_interference(result: LoopResult, partial: Partial) -> Drawing:
    """The spectrum of the channels that have the wave, and its amplitude in each channel."""
    named, observations = partial.named, result.observations
    frequency = named.candidate.form_parameters["frequency"][0]
    channels = np.flatnonzero(named.changed)
    everything = np.ones(len(observations), bool)
    wanted = stretches(observations, everything)
    piece = min(_LONGEST, int(np.median([stretch.stop - stretch.start for stretch in wanted])))
    after = result.attribution.residual
    figure = Figure(figsize=(11, 3.8), layout="constrained")
    left, right = figure.subplots(1, 2)
    for residual, colour, label in (
        (after + named.contribution, BEFORE, "before"),
        (after, AFTER, "after"),
    ):
        frequencies, density = power_density(residual, wanted, piece)
        left.semilogy(frequencies[1:], density[1:, channels].mean(axis=1), color=colour, label=label)
    left.axvline(frequency, color=NOISE, ls="--", lw=1, label=f"{frequency:.2f} Hz")
    left.set(xlabel="frequency, Hz", ylabel="power, counts²/Hz", title="channels with interference")
    left.grid(alpha=0.3)
    left.legend()
    amplitude = np.sqrt(2.0 * (named.contribution**2).mean(axis=0))
    right.bar(range(len(CHANNELS)), amplitude, color=BEFORE)
    right.set_xticks(range(len(CHANNELS)), CHANNELS, rotation=90)
    right.set(ylabel="amplitude, counts", title=f"the wave of {frequency:.2f} Hz")
    right.grid(axis="y", alpha=0.3)
    return figure, (
        f"Left: the spectrum of the residual in {', '.join(CHANNELS[place] for place in channels)}, with "
        "and without the wave. Right: the wave's amplitude in each channel, harmonics included."
    )


def draw_contact_offset(result: LoopResult, partial: Partial) -> Drawing:
    """How contacts scatter in each channel, and what a calibration of each would take off the error."""
    observations, blocks = result.observations, result.blocks
    left = result.attribution.residual + partial.named.contribution
    scale = np.array(observations.manifest.normalisation.output_std)
    contacts = runs(observations.contact)
    means = np.array([left[contact].mean(axis=0) for contact in contacts]) / scale
    within = np.array([left[contact].std(axis=0) for contact in contacts]) / scale
    figure = Figure(figsize=(11, 6.4), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True)
    places = np.arange(len(CHANNELS))
    aside = np.random.default_rng(0).uniform(-0.3, 0.3, len(means))
    upper.plot((places + aside[:, None]).ravel(), means.ravel(), ".", ms=3, color=BEFORE, alpha=0.5)
    usual = np.median(within, axis=0)
    for sign, label in ((1.0, "SD inside a contact"), (-1.0, None)):
        upper.hlines(sign * usual, places - 0.4, places + 0.4, color="black", lw=1.4, label=label)
    low, high = np.quantile(means, (0.005, 0.995))
    upper.set_ylim(1.15 * min(low, -float(usual.max())), 1.15 * max(high, float(usual.max())))
    upper.set(
        ylabel="mean residual / SD of the channel", title=f"one point a contact ({len(means)} contacts)"
    )
    upper.axhline(0, color="black", lw=0.7)
    upper.legend()
    counted = np.ones_like(left)
    width = 0.8 / len(CALIBRATIONS_S)
    for number, (seconds, colour) in enumerate(zip(CALIBRATIONS_S, (NOISE, AFTER), strict=True)):
        found = calibrated(observations, blocks, left, counted, seconds)
        shares = found.gain.sum(axis=0) / np.maximum(found.before.sum(axis=0), 1e-9)
        lower.bar(places - 0.4 + (number + 0.5) * width, 100 * shares, width, color=colour,
                  label=f"calibrated for {seconds:g} s: {shares.mean():.0%} in the mean")  # fmt: skip
    lower.axhline(0, color="black", lw=0.7)
    lower.set(ylabel="squared error that goes, %")
    lower.set_xticks(places, CHANNELS)
    lower.margins(y=0.25)
    lower.legend()
    for axes in (upper, lower):
        axes.grid(axis="y", alpha=0.3)
    return figure, (
        "Above: each contact's mean residual, with the other named effects taken out, beside the scatter "
        "inside contacts. Below: what goes of the squared error later in the contact if the mean of its "
        "first half second, or second, is taken off, on held-out folds of the fit part."
    )
