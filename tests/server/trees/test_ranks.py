"""The search of a row's values among the cuts, compared with NumPy's."""

import numba
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from taxel.manifest import Normalisation
from taxel_server.runtimes.compiled.arguments import pack, unpack
from taxel_server.runtimes.trees.few_rows.ranks import ROWS, Ranking, rank_rows
from taxel_server.runtimes.trees.layout.columns import Columns
from taxel_server.runtimes.trees.normalisation import Scales

HIGHEST = 65535


@numba.njit
def rank(plan, windows, ranks):  # type: ignore[no-untyped-def]
    ranking, scales = unpack(plan, Ranking, Scales)
    rank_rows(ranking, scales, windows, 0, len(windows), HIGHEST, 0, ranks.shape[1], ranks.ravel())


def columns_of(lengths: list[int], generator: np.random.Generator) -> Columns:
    cuts = [np.unique(generator.standard_normal(length).astype(np.float32)) for length in lengths]
    for each in cuts[::2]:
        each[-1:] = np.inf
    return Columns(
        bits=16,
        feature=np.arange(len(cuts), dtype=np.int32),
        default_left=np.arange(len(cuts)) % 3 == 0,
        start=np.cumsum([0, *map(len, cuts)]),
        cuts=np.concatenate([np.empty(0, np.float32), *cuts]),
        column=np.empty(0, np.int32),
        limit=np.empty(0, np.int16),
    )


@settings(max_examples=60, deadline=None)
@given(
    lengths=st.lists(
        st.one_of(st.integers(0, 40), st.integers(230, 260), st.integers(4000, 4200)), max_size=9
    ),
    seed=st.integers(0, 2**32 - 1),
)
def test_ranks_are_the_numbers_of_cuts_not_above(lengths: list[int], seed: int) -> None:
    generator = np.random.default_rng(seed)
    columns = columns_of(lengths, generator)
    windows = generator.standard_normal((ROWS, len(lengths))).astype(np.float32)
    expected = np.zeros(windows.shape, dtype=np.uint16)
    for column, (start, stop) in enumerate(zip(columns.start, columns.start[1:], strict=False)):
        cuts = columns.cuts[start:stop]
        if len(cuts):
            windows[1:4, column] = cuts[generator.integers(len(cuts), size=3)]
        windows[4:7, column] = np.inf, -np.inf, np.nan
        expected[:, column] = np.searchsorted(cuts, windows[:, column], side="right")
        expected[6, column] = 0 if columns.default_left[column] else HIGHEST
    mean, deviation = (0.0,) * len(lengths), (1.0,) * len(lengths)
    scales = Scales.of(
        Normalisation(
            input_mean=mean, input_std=deviation, output_mean=(), output_std=(), folded=bool(seed % 2)
        )
    )
    ranking, ranks = Ranking.of(columns), np.full(windows.shape, 7, dtype=np.uint16)
    rank(pack(ranking, scales), windows, ranks)
    np.testing.assert_array_equal(ranks, expected)


def test_as_many_cuts_as_a_rank_counts() -> None:
    columns = columns_of([0, 70_000], np.random.default_rng(0))
    columns.start[:] = 0, 0, 65535
    ranking = Ranking.of(columns)
    assert ranking.levels == 4
    windows = np.zeros((6, 2), dtype=np.float32)
    windows[:, 1] = columns.cuts[[0, 15, 16, 4095, 4096, 65534]]
    ranks = np.zeros(windows.shape, dtype=np.uint16)
    scales = Scales.of(
        Normalisation(input_mean=(0.0,) * 2, input_std=(1.0,) * 2, output_mean=(), output_std=())
    )
    rank(pack(ranking, scales), windows, ranks)
    assert ranks[:, 1].tolist() == [1, 16, 17, 4096, 4097, 65535]
