"""Proof: what must be shown before an effect is named, and which simpler one is named in its place."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from taxel_models.loop.effects.effect import Fitting
from taxel_models.loop.effects.lag import Lag
from taxel_models.loop.effects.saturation import Saturation
from taxel_models.loop.inference import proof
from taxel_models.loop.inference.constants import DECLARED
from taxel_models.loop.inference.contact_offset import ContactOffset
from taxel_models.loop.inference.proof import simplest


def rival(freedom: int, gain: float, evidence: float, worth: float) -> Any:
    """A score by its figures, and by the share of each channel's squared error that it removes."""
    return SimpleNamespace(
        effect=SimpleNamespace(is_predictable=True),
        freedom=freedom,
        total_gain=gain,
        log_evidence=evidence,
        worth=np.full(21, worth),
    )


@pytest.mark.parametrize(("worth", "first"), [(0.18, "gain"), (0.14, "kinds")])
def test_a_simpler_one_that_removes_as_much_in_counts_goes_first(worth: float, first: str) -> None:
    """Errors that last for a contact are few independent ones, and most of what there is to remove."""
    kinds, gain = rival(126, 5300.0, 4900.0, worth=0.15), rival(1, 2400.0, 1900.0, worth=worth)
    found = simplest(kinds, [kinds, gain], DECLARED)
    assert found is {"gain": gain, "kinds": kinds}[first]


def test_the_simplest_is_looked_for_step_by_step() -> None:
    def score(freedom: int, gain: float, evidence: float) -> Any:
        return rival(freedom, gain, evidence, worth=gain / 1e4)

    kinds, ageing, line = score(294, 1600.0, 1613.0), score(105, 1800.0, 1569.0), score(21, 2100.0, 1383.0)
    weak, constant = score(10, 1190.0, 1500.0), score(1, 900.0, 2000.0)
    assert simplest(kinds, [kinds, ageing], DECLARED) is ageing
    # It carries most of what the ageing does, which carries most of what the kinds do.
    assert simplest(kinds, [kinds, ageing, line], DECLARED) is line
    # These carry most of what the kinds do, or of nothing: the line explains more.
    assert simplest(kinds, [kinds, ageing, line, weak, constant], DECLARED) is line
    assert simplest(line, [kinds, ageing], DECLARED) is line
    # It is not half as simple, but explains more.
    assert simplest(kinds, [kinds, score(200, 1700.0, 1500.0)], DECLARED).freedom == 200
    assert simplest(kinds, [kinds, score(200, 1500.0, 1500.0)], DECLARED) is kinds


@pytest.mark.parametrize(("compared", "t", "stands"), [(1, 3.1, True), (15, 3.1, False), (15, 5.2, True)])
def test_what_was_chosen_among_many_must_be_surer(compared: int, t: float, stands: bool) -> None:
    """With eight folds, chance alone reaches 3.0 once in 100 times, and 5.1 once in 1500 times."""
    score = score_of(
        SimpleNamespace(
            is_predictable=True, is_constant=False, is_of_one_channel=False, fits_nothing=False
        ),
        Fitting(fixed=True, compared=compared),
        t=t,
        worth=np.full(21, 0.2),
    )
    assert proof.stands(score, False, DECLARED) is stands


def score_of(
    effect: Any,
    fitting: Fitting,
    *,
    t: float,
    worth: np.ndarray,
    channel_t: np.ndarray | None = None,
    ages: bool = False,
) -> Any:
    """A score on eight folds that changes all channels."""
    return SimpleNamespace(
        effect=effect,
        form=SimpleNamespace(candidate=SimpleNamespace(fitting=fitting, ages=ages)),
        weighed=SimpleNamespace(changes=np.ones(21, bool)),
        folds=8,
        chance=1.0 / fitting.compared,
        t=t,
        channel_t=np.zeros(21) if channel_t is None else channel_t,
        worth=worth,
    )


@pytest.mark.parametrize(
    ("worth", "t", "shared", "constant", "beside", "stands"),
    [
        pytest.param(0.05, 5.6, False, False, False, True, id="one channel, against chance among all"),
        pytest.param(0.05, 5.4, False, False, False, False, id="one channel, perhaps chance"),
        pytest.param(0.04, 9.0, False, False, False, False, id="one channel, too little"),
        pytest.param(0.05, 9.0, False, False, True, False, id="one channel, beside a named effect"),
        pytest.param(0.50, 9.0, False, False, True, False, id="one clear channel, beside a named effect"),
        pytest.param(0.16, 9.0, False, True, True, True, id="a clear offset, beside a named effect"),
        pytest.param(0.16, 5.4, False, True, True, False, id="a clear offset, perhaps chance"),
        pytest.param(0.14, 9.0, False, True, False, False, id="one channel's offset"),
        pytest.param(0.16, 9.0, False, True, False, True, id="one channel's clear offset"),
        pytest.param(0.50, 9.0, True, False, False, False, id="one channel of a cause that all share"),
        pytest.param(0.70, 9.0, True, False, False, True, id="all channels together"),
    ],
)
def test_one_channel_may_be_enough(
    worth: float, t: float, shared: bool, constant: bool, beside: bool, stands: bool
) -> None:
    """Of 21 channels, the others are a little worse with the effect; its t over all of them is 4.5."""
    score = score_of(
        SimpleNamespace(
            is_predictable=True, is_constant=constant, is_of_one_channel=False, fits_nothing=False
        ),
        Fitting(pooled=shared),
        t=4.5,
        channel_t=np.array([t] + [0.0] * 20),
        worth=np.array([worth] + [-0.001] * 20),
    )
    assert proof.stands(score, beside, DECLARED) is stands


@pytest.mark.parametrize(("worth", "stands"), [(0.16, True), (0.14, False)])
def test_a_channel_that_saturates_by_itself_shows_beside_a_named_effect(worth: float, stands: bool) -> None:
    score = score_of(
        Saturation(),
        Fitting(positive=True),
        t=4.5,
        channel_t=np.array([9.0] + [0.0] * 20),
        worth=np.array([worth] + [-0.001] * 20),
    )
    assert proof.stands(score, True, DECLARED) is stands


@pytest.mark.parametrize(
    ("worth", "t", "stands"),
    [(0.15, 3.1, True), (0.15, 2.9, False), (0.03, 4.3, True), (0.03, 4.1, False), (0.02, 9.0, False)],
)
def test_the_less_an_effect_removes_the_surer_it_must_be(worth: float, t: float, stands: bool) -> None:
    """With eight folds, chance reaches a t of 3.0 once in 100 times, and one of 4.2 in 500."""
    effect = SimpleNamespace(
        is_predictable=True, is_constant=False, is_of_one_channel=False, fits_nothing=False
    )
    score = score_of(effect, Fitting(), t=t, worth=np.full(21, worth))
    assert proof.stands(score, False, DECLARED) is stands


@pytest.mark.parametrize(
    ("worth", "t", "beside", "stands"),
    [
        (0.005, 3.1, False, True),
        (0.005, 2.9, False, False),
        (-0.005, 8.0, False, False),
        (0.005, 8.0, True, True),
        (0.005, 5.0, True, False),
        (-0.005, 8.0, True, False),
    ],
)
def test_a_delay_that_repeats_needs_no_share_of_the_error(
    worth: float, t: float, beside: bool, stands: bool
) -> None:
    """Beside a named effect it must be the surer, the less it removes."""
    score = score_of(Lag(), Fitting(fixed=True), t=t, worth=np.full(21, worth))
    assert proof.stands(score, beside, DECLARED) is stands


@pytest.mark.parametrize(("worth", "stands"), [(0.005, False), (0.1, True)])
def test_a_delay_that_grows_needs_a_share_as_others_do(worth: float, stands: bool) -> None:
    score = score_of(Lag(), Fitting(fixed=True), t=9.0, worth=np.full(21, worth), ages=True)
    assert proof.stands(score, False, DECLARED) is stands


@pytest.mark.parametrize(
    ("usual", "worth", "stands"), [(190.0, 0.06, True), (210.0, 0.06, False), (190.0, 0.04, False)]
)
def test_offsets_of_contacts_are_half_as_large_again_as_usual(
    usual: float, worth: float, stands: bool
) -> None:
    """Their variance scatters from recording to recording. They must be worth a calibration, too."""
    score = score_of(ContactOffset(), Fitting(), t=9.0, worth=np.full(21, worth))
    score.gain, score.usual = np.full((8, 21), 100.0 / (8 * 21)), np.full((8, 21), usual / (8 * 21))
    assert proof.stands(score, False, DECLARED) == stands
