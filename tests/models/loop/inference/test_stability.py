"""Random halves of the blocks."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from taxel_models.loop.blocks import FOLDS, Blocks
from taxel_models.loop.inference.stability import halved


@given(st.integers(16, 60), st.integers(0, 4), st.integers(0, 5))
def test_halves_come_in_pairs_that_share_no_block(count: int, pairs: int, seed: int) -> None:
    generator = np.random.default_rng(seed)
    tests = round(0.3 * count)
    fold = np.full(count, -1)
    fold[generator.permutation(count)[tests:]] = np.arange(count - tests) % FOLDS
    blocks = Blocks(np.arange(5 * count) // 5, fold)
    found = halved(blocks, 2 * pairs + 1, seed)
    assert len(found) == 2 * pairs + 1
    for half in found:
        used = half.fold >= 0
        assert not used[fold < 0].any()
        # Blocks that were held out together still are, and no fold is empty.
        assert np.array_equal(np.unique(half.fold[used]), np.arange(half.fold.max() + 1))
        together = {(old, new) for old, new in zip(fold[used], half.fold[used], strict=True)}
        assert len(together) == len(np.unique(fold[used])) == half.fold.max() + 1 >= 2
    for first, second in zip(found[:-1:2], found[1::2], strict=True):
        assert np.array_equal((first.fold >= 0) ^ (second.fold >= 0), fold >= 0)
