"""Which of several scores is taken."""

from dataclasses import replace
from typing import Final

import numpy as np
import pytest
from numpy.typing import NDArray
from taxel_models.loop.cross_validation import Score, cross_validate
from taxel_models.loop.model_selection import (
    CLEARLY_LESS,
    CONFOUNDED,
    CONTAINED,
    FOLD_LEVEL,
    could_replace,
    likeliest,
    more_specific,
    steadiest,
    worth_most,
)
from taxel_models.loop.statistics import Fitting, SufficientStatistics

from taxel_models.loop.basis import Shared
from taxel_models.loop.blocks import Blocks
from taxel_models.loop.effects.effect import Candidate

ROWS: Final = 2000
SCALE: Final = np.ones(21)
STEADY: Final = np.full(8, 0.5)
JUMPY: Final = np.array([0.0, 1.0, 0.1, 0.9, 0.2, 0.8, 0.3, 0.7])


def cause(
    name: str,
    fold_share: NDArray[np.float64],
    weights: NDArray[np.float64] | float = 1.0,
    *,
    figures: int = 1,
) -> Score:
    """What `figures` regressors explain of a residual that follows the first by so much a channel."""
    random = np.random.default_rng(0)
    features = random.normal(size=(ROWS, figures))
    residual = features[:, :1] * np.broadcast_to(weights, 21) + 0.01 * random.normal(size=(ROWS, 21))
    blocks = Blocks(np.repeat(np.arange(40), ROWS // 40), np.arange(40) % 8)
    statistics = SufficientStatistics.of(Shared(features), residual, np.ones(ROWS), blocks, Fitting())
    candidate = Candidate(name, "a form", Shared(features))
    found = cross_validate(candidate, statistics, SCALE)
    channel_share = np.repeat(fold_share[:, None], 21, axis=1)
    return replace(
        found, share=float(fold_share.mean()), fold_share=fold_share, channel_share=channel_share
    )


def test_unlikeness_is_the_electrodes_spread_over_their_mean() -> None:
    weights = np.concatenate([[50.0, -80.0], np.linspace(1.0, 3.0, 19)])
    electrodes = weights[2:]
    found = cause("one", STEADY, weights).unlikeness(SCALE)
    assert found == pytest.approx(electrodes.std() / electrodes.mean(), rel=0.01)


def test_what_explains_clearly_more_is_likelier_than_what_is_simple() -> None:
    simple, rich = cause("simple", STEADY), cause("rich", 1.02 * STEADY, figures=4)
    assert likeliest([simple, rich], SCALE) is rich


def test_of_two_that_do_as_well_the_simpler_is_likelier() -> None:
    simple, rich = cause("simple", JUMPY), cause("rich", JUMPY[::-1] + 0.001, figures=4)
    assert likeliest([rich, simple], SCALE) is simple


def test_what_explains_less_in_every_fold_does_not_do_as_well() -> None:
    simple, rich = cause("simple", JUMPY), cause("rich", JUMPY + 0.005, figures=4)
    assert simple.share > 0.985 * rich.share
    assert likeliest([rich, simple], SCALE) is rich


def test_a_much_simpler_one_may_explain_a_little_less() -> None:
    simple, more = cause("simple", JUMPY), JUMPY + np.tile([0.005, 0.025], 4)
    rich, half = cause("rich", more, figures=4), cause("half as simple", more, figures=2)
    assert CLEARLY_LESS < simple.against(rich)[1] < FOLD_LEVEL
    assert likeliest([rich, simple], SCALE) is simple
    assert likeliest([half, simple], SCALE) is half
    too_much = cause("rich", JUMPY + np.tile([0.01, 0.05], 4), figures=4)
    assert simple.against(too_much)[1] == pytest.approx(simple.against(rich)[1])
    assert likeliest([too_much, simple], SCALE) is too_much


def test_of_two_as_simple_the_one_whose_channels_are_alike_is_likelier() -> None:
    spread = np.linspace(0.2, 1.8, 21)
    alike, unlike = cause("alike", JUMPY), cause("unlike", JUMPY[::-1] + 0.001, spread)
    assert likeliest([unlike, alike], SCALE) is alike


def test_of_two_as_alike_the_one_whose_cause_says_so_is_likelier() -> None:
    says = cause("says", JUMPY, np.linspace(0.80, 1.20, 21))
    free = cause("free", JUMPY[::-1] + 0.001, np.linspace(0.81, 1.19, 21))
    assert likeliest([free, says], SCALE) is free
    says = replace(says, candidate=replace(says.candidate, alike=0.35))
    assert likeliest([free, says], SCALE) is says


def test_a_little_likeness_does_not_outweigh_the_data() -> None:
    # t is about 1.5 in favour of the better one: more than what 1 % less spread is worth.
    better = cause("better", JUMPY + 0.005 * (1 + np.linspace(-2, 2, 8)), np.linspace(0.2, 1.8, 21))
    worse = cause("worse", JUMPY, np.linspace(0.21, 1.79, 21))
    assert worse.unlikeness(SCALE) < better.unlikeness(SCALE)
    assert worse.against(better)[1] > FOLD_LEVEL
    assert likeliest([worse, better], SCALE) is better


@pytest.mark.parametrize(("figures", "least"), [(2, CONFOUNDED), (5, CONTAINED)])
def test_a_much_simpler_cause_may_stand_in_a_richer_ones_place_with_less(
    figures: int, least: float
) -> None:
    rich = cause("rich", STEADY, figures=figures)
    assert could_replace(rich, cause("simple", (least + 0.01) * STEADY))
    assert not could_replace(rich, cause("simple", (least - 0.01) * STEADY))


def test_what_does_not_repeat_has_to_explain_as_much() -> None:
    rich, jumpy = cause("rich", JUMPY, figures=5), np.array([4.0, *np.zeros(7)])
    assert could_replace(rich, cause("simple", 0.6 * JUMPY))
    assert not could_replace(rich, cause("simple", 0.6 * jumpy))
    assert could_replace(rich, cause("simple", jumpy))


def test_nothing_stands_in_the_place_of_what_is_certain_or_explains_nothing() -> None:
    score, other = cause("one", STEADY), cause("other", STEADY)
    certain = replace(score, candidate=replace(score.candidate, certain=True))
    assert could_replace(score, other)
    assert not could_replace(certain, other)
    assert not could_replace(cause("nothing", 0.0 * STEADY), other)


def shown_in(channels: list[int], share: float, *, figures: int = 1) -> tuple[Score, NDArray[np.float64]]:
    """A cause that explains so much of some channels in every fold, and what it is worth by channel."""
    worth = np.zeros(21)
    worth[channels] = share
    score = cause("few", STEADY * share * len(channels) / 21, figures=figures)
    steady = np.repeat(worth[None, :], 8, axis=0) + 0.01 * np.sin(np.arange(8))[:, None]
    return replace(score, channel_share=steady), worth


def test_a_cause_of_few_channels_that_explains_far_more_in_them_goes_first() -> None:
    (broad, wide), (few, worth) = shown_in(list(range(21)), 0.3, figures=4), shown_in([3, 4], 0.7)
    assert more_specific(broad, [(broad, wide), (few, worth)]) is few
    # Not where it explains little more, where it is of many channels, or where it has more figures.
    for other in (shown_in([3, 4], 0.4), shown_in(list(range(10)), 0.7), shown_in([3], 0.7, figures=5)):
        assert more_specific(broad, [(broad, wide), other]) is broad
    jumpy = replace(few, channel_share=few.channel_share * np.array([4.0, *np.zeros(7)])[:, None])
    assert more_specific(broad, [(jumpy, worth)]) is broad


def test_a_much_simpler_one_that_explains_more_competes_though_it_is_worth_less() -> None:
    rich, simple = cause("rich", STEADY, figures=4), cause("simple", 1.01 * STEADY)
    less = cause("less", 0.99 * STEADY)
    assert worth_most([(0.3, rich), (0.2, simple), (0.2, less), (0.28, less)]) == [rich, simple, less]
    half = cause("half as simple", 1.01 * STEADY, figures=2)
    assert worth_most([(0.3, rich), (0.2, half)]) == [rich]


def test_of_an_effects_forms_a_plain_one_that_repeats_is_taken_before_a_rich_one_that_does_not() -> None:
    once = np.array([4.0, *np.zeros(7)])
    rich, half = cause("rich", once, figures=4), cause("half", 0.45 * STEADY, figures=2)
    plain, poor = cause("plain", 0.4 * STEADY), cause("poor", 0.3 * STEADY)
    assert rich.share > plain.share > poor.share
    assert rich.repeats > FOLD_LEVEL > plain.repeats
    assert steadiest([rich, half, poor, plain]) is plain
    steady = cause("steady", 1.1 * STEADY, figures=4)
    assert steadiest([plain, steady, poor]) is steady
    # Where none repeats, the best stays the best.
    assert steadiest([rich, cause("worse", 0.5 * once)]) is rich
