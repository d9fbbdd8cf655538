"""Which channels' sensitivity changed, by how much and when."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from taxel.channels import CHANNELS, COUNTS_MAX
from taxel_models.loop.blocks import cut
from taxel_models.loop.channel_history import (
    LEAST_READING,
    MOST_CHANNELS,
    MOST_TOLD,
    ReadingChange,
    SensitivityChange,
    changed_channels,
    reading_changes,
    sensitivity_changes,
    usual_changes,
)
from taxel_models.loop.observations import gather
from taxel_models.loop.pipeline import LoopSettings, run_loop
from taxel_models.loop.reference.held_out import held_out_residual
from taxel_models.loop.session_change import largest_change
from taxel_models.recordings import Recording

pytestmark = pytest.mark.usefixtures("quick_references")

Make = Callable[..., Recording]
ROWS = 30_000
CHANNEL = 12


def changes(
    smooth: Any,
    recording: Recording,
    kept: NDArray[np.float64],
    added: float = 0.0,
    factor: float = 1.0,
    known: NDArray[np.bool_] | None = None,
) -> list[SensitivityChange]:
    """Of a recording in which one channel keeps a share (n,) of its sensitivity; some counts are added.

    A change by a factor is usual of this channel.
    """
    channels = recording.channels.copy()
    rest = smooth.counts(np.zeros((1, 3)), np.zeros((1, 3)))[0, CHANNEL]
    channels[:, CHANNEL] = rest + kept * (channels[:, CHANNEL] - rest) + added
    changed = Recording(recording.samples, np.rint(channels), recording.auxiliary, recording.covariates)
    observations = gather(smooth, [changed])
    explained = np.zeros_like(observations.residual)
    explained[:, CHANNEL] = added
    usual = np.ones(len(CHANNELS))
    usual[CHANNEL] = factor
    return list(sensitivity_changes(observations, cut(observations, seed=0), explained, usual, known))


@pytest.fixture(scope="module")
def long(make: Make) -> Recording:
    return make(ROWS, seed=5)


def test_a_step_is_told_with_its_time(smooth: Any, long: Recording) -> None:
    (found,) = changes(smooth, long, np.where(np.arange(ROWS) < 18_000, 1.0, 0.4))
    assert found.channel == CHANNELS[CHANNEL]
    assert found.kept == pytest.approx(0.4, abs=0.05)
    assert found.since_s == pytest.approx(180.0, abs=6.0)
    assert found.sentence().startswith("e11 lost 6")


def test_what_differs_from_kind_to_kind_is_no_change(smooth: Any, long: Recording) -> None:
    """Materials follow each other; where both are there before and after, the channel changed."""
    late = np.arange(ROWS) >= 18_000
    for material, told in ((late, 0), (np.arange(ROWS) // 1_500 % 2, 1), (np.arange(ROWS) // 1_500, 1)):
        recording = replace(long, covariates={"material": material.astype(np.float64)})
        assert len(changes(smooth, recording, np.where(late, 0.4, 1.0))) == told


def test_a_block_far_from_all_others_tells_no_line() -> None:
    time = np.array([*np.arange(12.0), 1_000.0])
    values = np.array([1.0, 1.2, 0.9, 1.1, 1.0, 0.8, 1.1, 1.0, 0.9, 1.2, 1.0, 1.1, -1.0])
    assert largest_change(np.array([time, time]), values).since_s is not None
    even = np.arange(13.0)
    assert largest_change(np.array([even, even]), 1.0 - 0.05 * even).since_s is None


def test_rows_that_say_nothing_are_not_looked_at(smooth: Any, long: Recording) -> None:
    late = np.arange(ROWS) >= 18_000
    kept = np.where(late, 0.4, 1.0)
    rows = gather(smooth, [long]).rows[0]
    assert changes(smooth, long, kept, known=~late[rows]) == []
    assert len(changes(smooth, long, kept, known=np.ones(len(rows), dtype=np.bool_))) == 1


def test_a_change_all_the_time_has_none(smooth: Any, long: Recording) -> None:
    (found,) = changes(smooth, long, np.linspace(1.0, 1.8, ROWS))
    assert found.kept == pytest.approx(1.8, abs=0.1)
    assert found.since_s is None
    assert found.sentence().endswith("more sensitive over this session.")


def test_a_channel_that_dies_early_is_told(smooth: Any, make: Make) -> None:
    """In most of the session it follows its prediction no more."""
    kept = np.where(np.arange(ROWS) < 9_000, 1.0, 0.0)
    (found,) = changes(smooth, make(ROWS, seed=5, noise=12.0), kept)
    assert found.kept < 0.05
    assert found.since_s == pytest.approx(90.0, abs=6.0)


def test_what_other_effects_add_is_no_sensitivity(smooth: Any, long: Recording) -> None:
    (found,) = changes(smooth, long, np.where(np.arange(ROWS) < 18_000, 1.0, 0.4), added=40.0)
    assert found.kept == pytest.approx(0.4, abs=0.05)


def test_what_is_usual_of_a_channel_is_not_told(smooth: Any, long: Recording) -> None:
    kept = np.where(np.arange(ROWS) < 18_000, 1.0, 1.8)
    assert len(changes(smooth, long, kept)) == 1
    assert changes(smooth, long, kept, factor=2.2) == []
    (dying,) = changes(smooth, long, np.where(np.arange(ROWS) < 18_000, 1.0, 0.2), factor=2.2)
    assert dying.kept == pytest.approx(0.2, abs=0.05)
    # A channel that does not read some of the materials from the start: nothing is told by its silence.
    dead = np.where(np.arange(ROWS) < 18_000, 1.0, 0.0)
    assert changes(smooth, long, dead, factor=MOST_TOLD) == []
    assert len(changes(smooth, long, dead, factor=2.2)) == 1


@pytest.mark.parametrize("later", [0.5, 2.0])
def test_what_is_usual_is_the_largest_change_either_way(smooth: Any, long: Recording, later: float) -> None:
    channels = long.channels.copy()
    rest = smooth.counts(np.zeros((1, 3)), np.zeros((1, 3)))[0, CHANNEL]
    channels[18_000:, CHANNEL] = rest + later * (channels[18_000:, CHANNEL] - rest)
    recording = Recording(long.samples, np.rint(channels), long.auxiliary, long.covariates)
    observations = gather(smooth, [recording])
    usual = usual_changes(observations, cut(observations, seed=0))
    assert usual[CHANNEL] == pytest.approx(2.0, abs=0.15)
    assert (np.delete(usual, CHANNEL) < 1.3).all()
    assert (usual >= 1.0).all()


def test_the_report_leaves_out_what_the_models_reference_shows(smooth: Any, make: Make) -> None:
    channels = (recording := make(12_000, seed=5, materials=False)).channels.copy()
    rest = smooth.counts(np.zeros((1, 3)), np.zeros((1, 3)))[0, CHANNEL]
    channels[6_000:, CHANNEL] = rest + 1.8 * (channels[6_000:, CHANNEL] - rest)
    changed = replace(recording, channels=np.rint(channels))
    reference = held_out_residual(smooth, [changed])
    assert reference is not None
    told = run_loop(smooth, [changed], LoopSettings(), reference=reference).findings
    assert told.changes == ()
    told = run_loop(smooth, [changed], LoopSettings(reference=False), reference=reference).findings
    assert [line.split()[0] for line in told.changes] == ["e11"]


@pytest.mark.parametrize("seed", range(4))
def test_nothing_is_told_of_a_sensor_that_stays(smooth: Any, make: Make, seed: int) -> None:
    assert changes(smooth, make(12_000, seed=seed, noise=12.0), np.ones(12_000)) == []


def test_a_channel_that_wakes_up_has_no_figure(smooth: Any, long: Recording) -> None:
    (found,) = changes(smooth, long, np.where(np.arange(ROWS) < 18_000, 0.03, 1.0))
    assert found.kept > 10
    assert "more than 10 times as sensitive at 1" in found.sentence()


def test_a_channel_that_did_not_follow_has_not_become_more_sensitive(smooth: Any, long: Recording) -> None:
    """A model that errs on what came first has small slopes there."""
    early = np.arange(ROWS) < 9_000
    error = np.where(early, np.random.default_rng(2).normal(size=ROWS) * 60.0, 0.0)
    recording = replace(long, channels=np.clip(long.channels + error[:, None], 0, COUNTS_MAX))
    assert changes(smooth, recording, np.where(early, 0.25, 1.0)) == []
    assert changes(smooth, long, np.where(early, 0.25, 1.0)) != []


def test_a_small_change_is_not_told(smooth: Any, long: Recording) -> None:
    assert changes(smooth, long, np.where(np.arange(ROWS) < 15_000, 1.0, 0.8)) == []


def test_few_blocks_tell_nothing(smooth: Any, make: Make) -> None:
    recording = make(1_800, seed=5)
    observations = gather(smooth, [recording])
    blocks = cut(observations, seed=0)
    some = observations.kept(blocks.of_row < 9)
    few = type(blocks)(blocks.of_row[blocks.of_row < 9], blocks.fold)
    usual = np.ones(len(CHANNELS))
    assert list(sensitivity_changes(some, few, np.zeros_like(some.residual), usual)) == []
    assert (usual_changes(some, few) == usual).all()


def test_a_channel_that_is_cut_off_lost_no_sensitivity(smooth: Any, make: Make) -> None:
    recording = make(ROWS, seed=5)
    channels, late = recording.channels.copy(), np.arange(ROWS) > 18_000
    # Most of what is far from rest is cut off, in the last part of the session.
    highest = float(np.quantile(channels[:, CHANNEL], 0.3))
    channels[late, CHANNEL] = np.minimum(channels[late, CHANNEL] + COUNTS_MAX - highest, COUNTS_MAX)
    changed = replace(recording, channels=np.rint(channels))
    observations = gather(smooth, [changed])
    cut_off = (observations.measured[:, CHANNEL] == COUNTS_MAX)[late[observations.rows[0]]]
    assert 0.2 < cut_off.mean() < 0.9
    blocks = cut(observations, seed=0)
    explained, usual = np.zeros_like(observations.residual), np.ones(len(CHANNELS))
    assert list(sensitivity_changes(observations, blocks, explained, usual)) == []


def readings(
    smooth: Any,
    recording: Recording,
    added: NDArray[np.float64],
    channels: int = 1,
    explained: bool = False,
    known: NDArray[np.bool_] | None = None,
) -> list[ReadingChange]:
    """Of a recording in which some channels from `CHANNEL` on read more by counts (n,).

    Args:
        explained: a named effect says so.
    """
    counts = recording.channels.copy()
    counts[:, CHANNEL : CHANNEL + channels] += added[:, None]
    observations = gather(smooth, [replace(recording, channels=np.rint(counts))])
    told = np.zeros_like(observations.residual)
    if explained:
        told[:, CHANNEL] = added[observations.rows[0]]
    blocks = cut(observations, seed=0)
    return reading_changes(observations, blocks, told, np.full(len(CHANNELS), 10.0), known)


@pytest.mark.parametrize(
    ("counts", "words"), [(-60.0, "60 counts less from"), (60.0, "60 counts more from")]
)
def test_a_reading_that_changed_is_told_with_its_time(
    smooth: Any, long: Recording, counts: float, words: str
) -> None:
    (found,) = readings(smooth, long, np.where(np.arange(ROWS) < 18_000, 0.0, counts))
    assert found.channel == CHANNELS[CHANNEL]
    assert found.counts == pytest.approx(counts, abs=3.0)
    assert found.since_s == pytest.approx(180.0, abs=6.0)
    assert f"{found.channel} reads {words}" in found.sentence()


def test_a_reading_that_changes_all_the_time_has_no_time(smooth: Any, long: Recording) -> None:
    (found,) = readings(smooth, long, np.linspace(0.0, -80.0, ROWS))
    assert found.counts == pytest.approx(-80.0, abs=5.0)
    assert found.since_s is None
    assert "at the end of this session than at its start" in found.sentence()


def test_readings_that_are_explained_or_small_or_unknown_are_not_told(smooth: Any, long: Recording) -> None:
    late = np.arange(ROWS) >= 18_000
    added = np.where(late, 60.0, 0.0)
    rows = gather(smooth, [long]).rows[0]
    assert readings(smooth, long, added, explained=True) == []
    assert readings(smooth, long, added, known=~late[rows]) == []
    assert readings(smooth, long, added * (LEAST_READING * 10.0 - 5.0) / 60.0) == []
    assert readings(smooth, long, 0.0 * added) == []


def test_what_many_channels_read_has_a_cause_that_they_share(smooth: Any, long: Recording) -> None:
    added = np.where(np.arange(ROWS) < 18_000, 0.0, 60.0)
    assert len(readings(smooth, long, added, channels=MOST_CHANNELS)) == MOST_CHANNELS
    assert readings(smooth, long, added, channels=MOST_CHANNELS + 1) == []


def test_a_channel_has_one_sentence(smooth: Any, long: Recording) -> None:
    """A sensitivity that changed changes the reading, too."""
    channels = long.channels.copy()
    rest = smooth.counts(np.zeros((1, 3)), np.zeros((1, 3)))[0, CHANNEL]
    channels[18_000:, CHANNEL] = rest + 0.3 * (channels[18_000:, CHANNEL] - rest)
    channels[18_000:, CHANNEL - 1] -= 60.0
    observations = gather(smooth, [replace(long, channels=np.rint(channels))])
    told = changed_channels(
        observations, cut(observations, seed=0), np.zeros_like(observations.residual), None
    )
    assert [change.channel for change in told] == [CHANNELS[CHANNEL], CHANNELS[CHANNEL - 1]]
    assert [type(change) for change in told] == [SensitivityChange, ReadingChange]
    assert [change.sentence().split()[0] for change in told] == [CHANNELS[CHANNEL], CHANNELS[CHANNEL - 1]]
