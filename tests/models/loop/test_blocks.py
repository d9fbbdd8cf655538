"""Blocks keep what is fitted apart from what is held out."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from taxel.errors import RecordingError
from taxel_models.loop.blocks import FEWEST, FOLDS, GUARD_ROWS, Blocks, cut
from taxel_models.loop.observations import Observations


@pytest.fixture(scope="module")
def of_segments(observations: Observations) -> Callable[[list[int]], Observations]:
    """Observations with segments of these lengths."""

    def made(lengths: list[int]) -> Observations:
        rows = np.arange(len(observations)) < sum(lengths)
        return replace(observations.kept(rows), segment=np.repeat(np.arange(len(lengths)), lengths))

    return made


def test_every_row_is_fitted_to_or_evaluated_on_or_a_guard(observations: Observations) -> None:
    blocks = cut(observations, seed=0)
    fit, evaluation, guard = blocks.fit, blocks.evaluation, blocks.of_row < 0
    np.testing.assert_array_equal(fit.astype(int) + evaluation + guard, 1)
    assert (blocks.fold < 0).sum() == round(0.3 * len(blocks))
    assert set(blocks.fold) == {-1, *range(min(FOLDS, int((blocks.fold >= 0).sum())))}
    assert guard.sum() == 2 * GUARD_ROWS * (len(blocks) - 1)


@settings(max_examples=25, deadline=None)
@given(
    lengths=st.lists(st.integers(30, 900), min_size=1, max_size=9),
    seed=st.integers(0, 99),
    held_out=st.floats(0.1, 0.6),
)
def test_rows_of_two_parts_are_never_neighbours(
    of_segments: Callable[[list[int]], Observations], lengths: list[int], seed: int, held_out: float
) -> None:
    observations = of_segments(lengths)
    try:
        blocks = cut(observations, seed=seed, held_out=held_out)
    except RecordingError:
        assert sum(lengths) < FEWEST * 200
        return
    part = np.where(blocks.of_row < 0, -2, blocks.fold[blocks.of_row])
    for apart in range(1, 2 * GUARD_ROWS):
        same = observations.segment[apart:] == observations.segment[:-apart]
        first, second = part[:-apart][same], part[apart:][same]
        assert ((first == second) | (first == -2) | (second == -2)).all()


def test_no_block_runs_across_a_gap(of_segments: Callable[[list[int]], Observations]) -> None:
    observations = of_segments([700, 90, 1500, 40, 2000, 900])
    blocks = cut(observations, seed=1)
    for number in range(len(blocks)):
        assert len(set(observations.segment[blocks.of_row == number])) <= 1


def test_short_segments_are_whole_blocks(of_segments: Callable[[list[int]], Observations]) -> None:
    observations = of_segments([200] * 40)
    blocks = cut(observations, seed=1)
    np.testing.assert_array_equal(blocks.of_row, observations.segment)


def test_a_seed_says_everything(observations: Observations) -> None:
    first, again, other = (cut(observations, seed=seed).fold for seed in (4, 4, 5))
    np.testing.assert_array_equal(first, again)
    assert (first != other).any()


def test_values_of_a_group_stay_together(observations: Observations) -> None:
    # The material changes every three seconds, inside what would else be a block.
    material = observations.covariates["material"]
    blocks = cut(observations, seed=3, group="material")
    held_out = set(material[blocks.evaluation])
    assert len(held_out) == round(0.3 * 5)
    assert held_out.isdisjoint(set(material[blocks.fit]))
    for fold in range(int(blocks.fold.max()) + 1):
        own = blocks.fit & (blocks.fold[blocks.of_row] == fold)
        assert set(material[own]).isdisjoint(set(material[blocks.fit & ~own]))


def test_what_cannot_be_held_out_is_refused(observations: Observations) -> None:
    with pytest.raises(RecordingError, match=r"no covariate 'mood' to hold out by.* material"):
        cut(observations, seed=0, group="mood")
    fast = replace(observations, covariates={"fast": np.arange(len(observations)) % 9.0})
    with pytest.raises(RecordingError, match="fast changes 8979 times in 8980 rows: too often"):
        cut(fast, seed=0, group="fast")
    few = replace(observations, covariates={"two": np.arange(len(observations)) // 900 % 2.0})
    with pytest.raises(RecordingError, match="two has 2 values: expected at least 4"):
        cut(few, seed=0, group="two")
    short = observations.kept(np.arange(len(observations)) < 900)
    with pytest.raises(RecordingError, match="900 rows make 9 blocks: expected at least 16"):
        cut(short, seed=0)


def test_guards_are_in_no_part() -> None:
    blocks = Blocks(np.array([0, 0, -1, -1, 1, 1]), np.array([-1, 0]))
    np.testing.assert_array_equal(blocks.evaluation, [True, True, False, False, False, False])
    np.testing.assert_array_equal(blocks.fit, [False, False, False, False, True, True])
