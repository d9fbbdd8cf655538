"""Offsets of contacts: what a calibration would bring, and whether they are there."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy import stats

from taxel_models.loop.blocks import Blocks
from taxel_models.loop.inference import contact_offset
from taxel_models.loop.inference.constants import DECLARED
from taxel_models.loop.observations import Observations, gather
from taxel_models.loop.pipeline import LoopSettings, run_loop
from taxel_models.loop.reference.held_out import held_out_residual

pytestmark = pytest.mark.usefixtures("quick_references")

CONTACTS, LENGTH = 24, 300
ROWS = CONTACTS * LENGTH


@pytest.fixture(scope="module")
def contacts(observations: Observations) -> tuple[Observations, Blocks]:
    """Contacts of three seconds, each a block; six folds and an evaluation part."""
    segment = np.repeat(np.arange(CONTACTS), LENGTH)
    some = replace(observations.kept(np.arange(len(observations)) < ROWS), segment=segment)
    return some, Blocks(segment, np.arange(CONTACTS) % 7 - 1)


def offsets(seed: int = 0) -> np.ndarray:
    """(n, 21) an offset of each contact, counts."""
    return np.repeat(np.random.default_rng(seed).normal(size=(CONTACTS, 21)) * 20, LENGTH, axis=0)


def test_offsets_that_stay_are_removed_whole(contacts: tuple[Observations, Blocks]) -> None:
    left = offsets()
    found = contact_offset.calibrated(*contacts, left, np.ones_like(left), 0.5)
    np.testing.assert_allclose(found.offsets, left)
    np.testing.assert_allclose(found.shares, 1.0)
    np.testing.assert_allclose(found.gain, found.before)
    later = contacts[1].fit & (np.arange(ROWS) % LENGTH >= 50)
    np.testing.assert_allclose(found.before.sum(axis=0), (left[later] ** 2).sum(axis=0))


def test_of_offsets_that_fade_the_share_that_stays_is_found(contacts: tuple[Observations, Blocks]) -> None:
    left = offsets() * np.where(np.arange(ROWS) % LENGTH < 100, 1.0, 0.5)[:, None]
    found = contact_offset.calibrated(*contacts, left, np.ones_like(left), 1.0)
    np.testing.assert_allclose(found.shares, 0.5)
    np.testing.assert_allclose(found.gain, found.before)


def test_shares_are_tested_on_folds_that_they_were_not_fitted_to(
    contacts: tuple[Observations, Blocks],
) -> None:
    observations, blocks = contacts
    left = np.random.default_rng(1).normal(size=(ROWS, 21)) + offsets(2) / 40
    counted = np.random.default_rng(2).uniform(0.2, 1.0, size=left.shape)
    found = contact_offset.calibrated(observations, blocks, left, counted, 0.5)
    fold = blocks.fold[blocks.of_row]
    later = np.arange(ROWS) % LENGTH >= 50
    for held_out in range(6):
        fit = later & (fold >= 0) & (fold != held_out)
        own = (counted[fit] * found.offsets[fit] ** 2).sum(axis=0)
        share = np.clip((counted[fit] * left[fit] * found.offsets[fit]).sum(axis=0) / own, 0, 1)
        test = later & (fold == held_out)
        after = (counted[test] * (left[test] - share * found.offsets[test]) ** 2).sum(axis=0)
        before = (counted[test] * left[test] ** 2).sum(axis=0)
        np.testing.assert_allclose(found.before[held_out], before)
        np.testing.assert_allclose(found.gain[held_out], before - after, atol=1e-6)


def test_a_contact_that_ends_while_it_is_calibrated_counts_nothing(
    contacts: tuple[Observations, Blocks],
) -> None:
    observations, blocks = contacts
    found = contact_offset.calibrated(observations, blocks, offsets(), np.ones((ROWS, 21)), 3.0)
    assert not found.before.any()
    assert not found.gain.any()


def test_a_recording_in_one_piece_has_a_contact_for_each_touch(observations: Observations) -> None:
    rows = 1_000
    seconds = np.arange(rows) / 100
    # The air before the first touch is apart; less than 0.1 s of air ends no touch.
    pressed = (seconds > 0.5) & (seconds % 2.0 < 1.2)
    pressed[60:66] = False
    force = np.zeros((rows, 3))
    force[pressed, 2] = -1.0
    piece = replace(
        observations.kept(np.arange(len(observations)) < rows), force=force, segment=np.zeros(rows, int)
    )
    np.testing.assert_array_equal(piece.contact, (seconds // 2.0).astype(int) + (seconds > 0.5))
    in_trials = replace(piece, segment=np.arange(rows) // 100)
    np.testing.assert_array_equal(in_trials.contact, in_trials.segment)


def test_offsets_of_touches_are_named_in_a_recording_in_one_piece(smooth: Any, make: Any) -> None:
    recording = make(12_000, seed=5)
    reference = held_out_residual(smooth, [make(9_000, seed=6, materials=False)])
    contact = gather(smooth, [recording]).contact
    assert contact.max() > 20
    drawn = np.random.default_rng(7).normal(size=(contact.max() + 1, 21)) * 12.0
    channels = recording.channels.copy()
    channels[10:-10] = np.clip(np.rint(channels[10:-10] + drawn[contact]), 0, 4095)
    moved = replace(recording, channels=channels)
    found = run_loop(smooth, [moved], LoopSettings(), reference=reference).findings
    assert [effect.name for effect in found.effects] == ["offset:contact"]


def test_evidence_is_that_of_a_random_constant_of_each_contact() -> None:
    random = np.random.default_rng(3)
    blocks = (slice(0, 8), slice(8, 20), slice(20, 25))
    white, ones = random.normal(size=(21, 25)), random.normal(size=(21, 25, 2))
    ones[:, blocks[1], 1] = 0.0
    expected = 0.0
    strength = DECLARED.strengths[1]
    for channel in range(21):
        shape = np.eye(25)
        for block in blocks:
            shape[block, block] += strength**2 * ones[channel, block] @ ones[channel, block].T
        expected += stats.multivariate_t(shape=shape, df=1e-7).logpdf(white[channel])
        expected -= stats.multivariate_t(shape=np.eye(25), df=1e-7).logpdf(white[channel])
    found = contact_offset.log_evidence(white, ones, blocks, DECLARED.strengths)
    assert found[1].sum() == pytest.approx(expected, abs=1e-3)


def test_evidence_is_that_of_a_random_constant_of_each_block() -> None:
    random = np.random.default_rng(3)
    blocks = (slice(0, 8), slice(8, 20), slice(20, 25))
    ones = np.repeat(random.uniform(0.5, 1.0, size=(21, 1)), 25, axis=1)
    white = random.normal(size=(21, 25))
    for block in blocks:
        white[:, block] += random.normal(size=(21, 1)) * 0.7
    odds = []
    for strength in DECLARED.strengths:
        total = 0.0
        for channel in range(21):
            shape = np.eye(25)
            for block in blocks:
                shape[block, block] += strength**2 * np.outer(ones[channel, block], ones[channel, block])
            total += stats.multivariate_t(shape=shape, df=1e-7).logpdf(white[channel])
            total -= stats.multivariate_t(shape=np.eye(25), df=1e-7).logpdf(white[channel])
        odds.append(total)
    found = contact_offset.log_evidence(white, ones[..., None], blocks, DECLARED.strengths)
    assert found.sum(axis=1) == pytest.approx(odds, abs=1e-3)


def test_what_is_reported_cannot_be_served(contacts: tuple[Observations, Blocks], smooth: Any) -> None:
    candidate = contact_offset.ContactOffset().form(offsets(), {0.5: 0.4, 1.0: 0.55})
    assert candidate.form == (
        "of each contact; calibrating for 0.5 s would remove 40%, 1 s would remove 55% of the squared error"
    )
    assert not candidate.online(np.ones((21, 1))).changes_something
    np.testing.assert_allclose(candidate.basis.times(np.ones((21, 1))), offsets(), rtol=1e-6)
    assert candidate.again is not None
    assert candidate.again(contacts[0]).form == candidate.form
