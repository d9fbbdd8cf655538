"""Twins whose errors are those of another finger: nothing in them follows the contact."""

import numpy as np
import pytest

from taxel_models.ground.ground import predicted
from taxel_models.ground.twins import StoredModel, TwinGround, contacts_of, other_constants
from taxel_models.shipped import shipped_repository
from taxel_models.twin import simulate
from taxel_models.twin.constants import Constants


@pytest.fixture(scope="module")
def ground() -> TwinGround:
    return TwinGround(StoredModel(shipped_repository(), "network-b"), seed=2, rows=8_000)


def test_errors_have_a_size_but_follow_neither_force_nor_place(ground: TwinGround) -> None:
    clean = ground.clean(0)
    counts, rows = predicted(clean.model, clean.recording)
    residual = clean.recording.channels[rows] - counts
    assert (np.abs(residual.mean(axis=0)) < 1.0).all()
    assert (residual.std(axis=0) > 3.0).all()
    force = np.linalg.norm(clean.recording.samples.force[rows], axis=1)
    columns = np.column_stack([force, force**2, clean.recording.samples.position[rows]])
    scaled = (columns - columns.mean(axis=0)) / columns.std(axis=0)
    weights, *_ = np.linalg.lstsq(scaled, residual, rcond=None)
    explained = 1.0 - ((residual - scaled @ weights) ** 2).mean(axis=0) / residual.var(axis=0)
    assert np.median(explained) < 0.05


def test_contacts_begin_with_a_touch() -> None:
    recording = simulate(6000, 4)
    contacts = contacts_of(recording)
    pressed = np.linalg.norm(recording.samples.force, axis=1) > 0.1
    assert contacts.max() >= 8
    begins = np.flatnonzero(np.diff(contacts)) + 1
    assert pressed[begins].all()
    assert not pressed[begins - 1].any()


def test_constants_change_the_twin() -> None:
    usual, same = simulate(4000, 4), simulate(4000, 4, Constants())
    np.testing.assert_array_equal(usual.channels, same.channels)
    random = np.random.default_rng(0)
    other = simulate(4000, 4, other_constants(random))
    free = np.linalg.norm(usual.samples.force, axis=1) < 0.05
    moved = other.channels[free, 2:].mean(axis=0) - usual.channels[free, 2:].mean(axis=0)
    assert np.abs(moved).max() > 30.0
    assert other.auxiliary["tdc"].std() < 2.0 < np.ptp(usual.auxiliary["tdc"])
