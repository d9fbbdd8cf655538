"""What must be removed to be named, where the model does not know what it is asked about."""

import pytest

from taxel_models.loop.inference.constants import DECLARED


def test_on_new_kinds_an_effect_must_remove_more() -> None:
    assert DECLARED.with_new_kinds(0.0) == DECLARED
    all_new = DECLARED.with_new_kinds(1.0)
    assert all_new.least_share == pytest.approx(DECLARED.clear_share)
    assert all_new.least_channel_share == pytest.approx(DECLARED.clear_share)
    assert all_new.clear_share == pytest.approx(0.45)
    some = DECLARED.with_new_kinds(0.25)
    assert some.least_share == pytest.approx(0.0375)
    assert some.clear_share == pytest.approx(0.16875)


def test_no_share_rises_above_all_of_it() -> None:
    assert DECLARED.moved("clear_share", 4.0).with_new_kinds(1.0).clear_share == 1.0
