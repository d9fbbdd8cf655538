"""Whole courses of contacts: what a contact's positions share is told apart from what they do not."""

import numpy as np
import pytest

from taxel.skin import patch
from taxel_models.calibration.fit import Fit, fit
from taxel_models.calibration.light_contacts import LightContacts

RADIUS = 7.0
CONTACTS, POSITIONS = 300, 8
STANDOFF, SOFTNESS, CONTACT_ERROR, POSITION_ERROR = 2.0, 0.7, 0.5, 0.04


def pressed_and_slid(seed: int) -> LightContacts:
    """Contacts that slide some millimetres while they are pressed and let go."""
    dice = np.random.default_rng(seed)
    share = np.linspace(0.0, 1.0, POSITIONS)
    along = dice.uniform(-14.0, 10.0, CONTACTS)[:, None] + 3.0 * dice.standard_normal((CONTACTS, 1)) * share
    around = dice.uniform(-1.8, 1.8, CONTACTS)[:, None] + 0.4 * dice.standard_normal((CONTACTS, 1)) * share
    places = patch(np.clip(along, -14.0, 10.0).ravel(), around.ravel(), RADIUS)
    peak = dice.uniform(0.3, 1.0, CONTACTS)[:, None]
    force = (0.06 + (peak - 0.06) * np.sin(np.pi * share)).ravel()
    softness = SOFTNESS + 0.1 * dice.standard_normal(CONTACTS)
    height = STANDOFF - np.repeat(softness, POSITIONS) * force ** (2.0 / 3.0)
    shared = np.repeat(CONTACT_ERROR * dice.standard_normal((CONTACTS, 3)), POSITIONS, axis=0)
    own = POSITION_ERROR * dice.standard_normal(places.point.shape)
    course = places.point + height[:, None] * places.normal + shared + own
    starts = POSITIONS * np.arange(CONTACTS)
    return LightContacts(course, force, starts, course[starts])


def touches_alone(contacts: LightContacts) -> LightContacts:
    ends = contacts.ends
    return LightContacts(
        contacts.course[ends], contacts.force[ends], np.arange(len(contacts)), contacts.first
    )


def off(found: Fit, contacts: LightContacts) -> float:
    """How far the placement moves contacts that are already in place, mm."""
    moved = found.placement.motion.apply(contacts.position) - contacts.position
    return float(np.linalg.norm(moved, axis=1).mean())


@pytest.fixture(scope="module")
def found() -> list[tuple[LightContacts, Fit]]:
    made = [pressed_and_slid(seed) for seed in range(6)]
    return [(contacts, fit(contacts, RADIUS, 0)) for contacts in made]


def test_courses_tell_the_place_better_than_light_touches_alone(
    found: list[tuple[LightContacts, Fit]],
) -> None:
    whole = [off(by_courses, contacts) for contacts, by_courses in found]
    touches = [off(fit(touches_alone(contacts), RADIUS, 0), contacts) for contacts, _ in found]
    assert max(whole) < 0.2
    assert np.mean(whole) < 0.65 * np.mean(touches)


def test_spreads_standoff_and_softness_are_those_that_were_drawn(
    found: list[tuple[LightContacts, Fit]],
) -> None:
    for _, by_courses in found:
        assert by_courses.contact_error == pytest.approx(CONTACT_ERROR, rel=0.2)
        assert by_courses.position_error == pytest.approx(POSITION_ERROR, rel=0.1)
        assert by_courses.softness == pytest.approx(SOFTNESS, abs=0.05)
        assert by_courses.placement.standoff == pytest.approx(STANDOFF, abs=0.15)


def test_intervals_are_as_wide_as_the_errors_are_large(found: list[tuple[LightContacts, Fit]]) -> None:
    shares = [by.placement.values[:5] / by.resampled.std(axis=0)[:5] for _, by in found]
    assert 0.5 < np.sqrt(np.mean(np.square(shares))) < 1.5


def test_the_indentation_of_light_touches_is_taken_off(found: list[tuple[LightContacts, Fit]]) -> None:
    for contacts, by_courses in found:
        assert len(by_courses.after) == len(contacts)
        indented = SOFTNESS * contacts.force[contacts.ends].mean() ** (2.0 / 3.0)
        assert abs(by_courses.after.mean()) < 0.05 < indented


def test_a_tracker_that_errs_anew_at_each_position_is_told_by_its_spread() -> None:
    contacts = pressed_and_slid(0)
    dice = np.random.default_rng(1)
    course = contacts.course + 1.0 * dice.standard_normal(contacts.course.shape)
    noisy = fit(LightContacts(course, contacts.force, contacts.starts, contacts.first), RADIUS, 0)
    assert noisy.position_error == pytest.approx(1.0, rel=0.1)
    assert off(noisy, contacts) < 0.5
