"""Which channels that keep a value are faults: not those that were cut off, or whose signal is weak."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from taxel.channels import CHANNELS, COUNTS_MAX
from taxel_models.loop.effects.effect import Remaining
from taxel_models.loop.effects.fault import Fault
from taxel_models.loop.loose_contacts import loose_contacts
from taxel_models.loop.observations import Observations, gather
from taxel_models.loop.stuck_at import stuck_channels
from taxel_models.recordings import Recording

Make = Callable[..., Recording]
E5 = CHANNELS.index("e5")


def observed(smooth: Any, make: Make) -> Observations:
    """In segments of 6.8 s."""
    ticks = make(seed=3).ticks()
    parts = ticks.rows(np.arange(len(ticks)) % 700 >= 20)
    return gather(smooth, [parts])


def forms(observations: Observations) -> list[str]:
    rows = np.ones(len(observations), bool)
    remaining = Remaining(observations.residual, rows, np.ones(len(observations)))
    return [candidate.form for candidate in Fault().forms(observations, remaining)]


def with_e5(observations: Observations, rows: np.ndarray, counts: np.ndarray | float) -> Observations:
    measured = observations.measured.copy()
    measured[rows, E5] = np.broadcast_to(counts, rows.shape)[rows]
    return replace(observations, measured=measured)


def test_a_channel_at_its_limit_for_whole_segments_is_cut_off(smooth: Any, make: Make) -> None:
    """As by an offset of single contacts: nobody sees it jump there."""
    observations = observed(smooth, make)
    whole = np.isin(observations.segment, [2, 5, 9])
    assert forms(with_e5(observations, whole, COUNTS_MAX)) == []
    # Within a segment it jumps there and back.
    within = np.zeros(len(whole), bool)
    for segment in (2, 5, 9):
        within[np.flatnonzero(observations.segment == segment)[200:400]] = True
    assert forms(with_e5(observations, within, COUNTS_MAX)) == ["intermittent: e5"]


def test_a_channel_that_a_press_leads_to_its_limit_is_cut_off(smooth: Any, make: Make) -> None:
    """In some segments an offset brings it near the limit; a fast press does the rest in one step."""
    observations = observed(smooth, make)
    signal = observations.predicted[:, E5] - observations.predicted[:, E5].min()
    signal = np.where(signal > np.median(signal), 900.0, 100.0) + 0.2 * signal
    predicted = observations.predicted.copy()
    predicted[:, E5] = 2500.0 + signal
    shifted = np.isin(observations.segment, [2, 5, 9])
    noise = np.random.default_rng(2).normal(0.0, 3.0, len(signal))
    counts = np.rint(predicted[:, E5] + noise + np.where(shifted, 900.0, 0.0)).clip(0, COUNTS_MAX)
    assert 0.01 < (counts == COUNTS_MAX).mean() < 0.3
    given = replace(observations, predicted=predicted)
    assert forms(with_e5(given, np.ones(len(counts), bool), counts)) == []


def test_a_channel_that_a_drift_leads_to_its_limit_for_good_is_cut_off(smooth: Any, make: Make) -> None:
    """Segments after that show nothing else, so that what the channel showed before them tells."""
    observations = observed(smooth, make)
    predicted = observations.predicted.copy()
    predicted[:, E5] = 3000.0 + 0.1 * (predicted[:, E5] - predicted[:, E5].mean())
    given, every = replace(observations, predicted=predicted), np.ones(len(predicted), bool)
    share = observations.time_s / observations.time_s[-1]
    noise = np.random.default_rng(2).normal(0.0, 3.0, len(share))
    drifting = np.rint(predicted[:, E5] + noise + 2000.0 * share).clip(0, COUNTS_MAX)
    assert (drifting[share > 0.7] == COUNTS_MAX).all()
    assert forms(with_e5(given, every, drifting)) == []
    broken = np.where(share > 0.7, COUNTS_MAX, np.rint(predicted[:, E5] + noise))
    assert forms(with_e5(given, every, broken)) == ["stuck: e5 at 4095 from 63 s on"]


def test_a_channel_is_served_as_stuck_if_it_never_worked(smooth: Any, make: Make) -> None:
    """One that worked before has no value that it always had."""
    observations = observed(smooth, make)
    every = np.ones(len(observations), bool)
    late = np.arange(len(every)) >= 0.6 * len(every)
    for rows, form, serves in (
        (every, "stuck: e5 at 200", True),
        (late, f"stuck: e5 at 200 from {observations.time_s[late][0]:.0f} s on", False),
    ):
        given = with_e5(observations, rows, 200.0)
        remaining = Remaining(given.residual, every, np.ones(len(every)))
        (candidate,) = Fault().forms(given, remaining)
        assert candidate.form == form
        assert candidate.online(np.ones((21, 1))).changes_something == serves
        assert "worked before" in Fault.why_only_reported(form)


def test_a_channel_that_keeps_what_the_model_says_is_no_fault(smooth: Any, make: Make) -> None:
    """It had no signal in training, either."""
    observations = observed(smooth, make)
    predicted = observations.predicted.copy()
    predicted[:, E5] = 1.0
    known = replace(observations, predicted=predicted)
    every = np.ones(len(predicted), bool)
    assert forms(with_e5(known, every, 0.0)) == []
    assert forms(with_e5(known, every, 40.0)) == ["stuck: e5 at 40"]


def test_a_value_that_is_kept_once_for_a_second_is_no_fault(smooth: Any, make: Make) -> None:
    observations = observed(smooth, make)
    rows = np.zeros(len(observations), bool)
    rows[np.flatnonzero(observations.segment == 4)[200:300]] = True
    assert rows.sum() >= 0.01 * len(rows)
    value = float(observations.measured[:, E5].max() + 300.0)
    assert forms(with_e5(observations, rows, value)) == ["intermittent: e5"]
    rows[np.flatnonzero(rows)[40:]] = False
    assert rows.sum() < 0.01 * len(rows)
    assert forms(with_e5(observations, rows, value)) == []


def test_a_channel_that_saturates_into_a_few_counts_is_no_fault(smooth: Any, make: Make) -> None:
    """It keeps the end of all that it shows whenever it is pressed; a loose contact jumps there."""
    observations = observed(smooth, make)
    signal = np.abs(observations.predicted[:, E5] - np.median(observations.predicted[:, E5]))
    counts = 1000.0 + np.rint(9.0 * np.tanh(signal / np.quantile(signal, 0.3)))
    every = np.ones(len(counts), bool)
    given = with_e5(observations, every, counts)
    seen = given.measured, given.predicted, given.segment
    assert [found.channel for found in stuck_channels(*seen)] == [E5]
    assert forms(given) == []
    jumping = np.where(counts == counts.max(), counts + 300.0, counts)
    assert forms(with_e5(observations, every, jumping)) == ["intermittent: e5"]


def test_a_channel_that_is_cut_off_is_no_loose_contact_where_some_presses_are_quick(
    smooth: Any, make: Make
) -> None:
    """It reads one level then, and its neighbours by rounding; it comes there by usual steps as well."""
    observations = observed(smooth, make)
    slow, quick = np.repeat([0.0, 120.0], [100, 160]), np.repeat([0.0, 120.0], [60, 40])
    slow[100:] *= np.sin(np.linspace(0.0, np.pi, 160))
    signal = np.resize(np.concatenate([slow, slow, slow, quick]), len(observations))
    predicted = observations.predicted.copy()
    signal += 15.0 * np.sin(np.arange(len(signal)) / 37.0)
    predicted[:, E5] = 1_000.0 + signal
    read = 1_000.0 + np.rint(np.minimum(signal, 60.0))
    read[::50] -= read[::50] == 1_060.0
    every = np.ones(len(observations), bool)
    given = with_e5(replace(observations, predicted=predicted), every, read)
    assert loose_contacts(given.measured, given.predicted, given.segment)
    assert forms(given) == []


def test_a_channel_that_errs_as_much_elsewhere_is_weak(smooth: Any, make: Make) -> None:
    """It keeps a value near the prediction for a while, and is far from it in all other rows."""
    observations = observed(smooth, make)
    rows = np.zeros(len(observations), bool)
    for segment in (2, 5, 9):
        rows[np.flatnonzero(observations.segment == segment)[200:300]] = True
    value = float(np.rint(observations.predicted[rows, E5].mean()))
    assert forms(with_e5(observations, rows, value + 300.0)) == ["intermittent: e5"]
    away = observations.measured[:, E5] + np.where(rows, 0.0, 500.0)
    assert forms(with_e5(with_e5(observations, ~rows, away), rows, value)) == []
