"""The ranks of a row's values among the cuts, compared with NumPy's search."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from taxel.manifest import Normalisation
from taxel_server.runtimes.compiled.arguments import pack
from taxel_server.runtimes.compiled.compiling import compiled
from taxel_server.runtimes.trees.few_rows.kernels import ROWS, padded_cuts, rank_rows
from taxel_server.runtimes.trees.layout.columns import Columns, Cuts, read_cuts
from taxel_server.runtimes.trees.normalisation import Scales, read_scales

_SCALES = len(Cuts._fields)


@compiled
def rank(arguments: NDArray[np.int64], windows: NDArray[np.float32], ranks: NDArray[np.int8]) -> None:
    cuts, scales = read_cuts(arguments, 0), read_scales(arguments, _SCALES)
    rank_rows(cuts, scales, windows, 0, len(windows), ranks.shape[1], ranks.ravel())


def columns_of(lengths: list[int], generator: np.random.Generator) -> Columns:
    cuts = [np.unique(generator.standard_normal(length).astype(np.float32)) for length in lengths]
    for each in cuts[::2]:
        each[-1:] = np.inf
    laid_out = Cuts(
        feature=np.arange(len(cuts), dtype=np.int32),
        default_left=np.arange(len(cuts)) % 3 == 0,
        start=np.cumsum([0, *map(len, cuts)]),
        cuts=np.concatenate([np.empty(0, np.float32), *cuts]),
    )
    return Columns(laid_out, column=np.empty(0, np.int32), limit=np.empty(0, np.int8))


@settings(max_examples=60, deadline=None)
@given(
    lengths=st.lists(st.one_of(st.integers(0, 40), st.integers(230, 255)), max_size=9),
    seed=st.integers(0, 2**32 - 1),
)
def test_ranks_are_the_numbers_of_cuts_not_above(lengths: list[int], seed: int) -> None:
    generator = np.random.default_rng(seed)
    columns = columns_of(lengths, generator)
    windows = generator.standard_normal((ROWS, len(lengths))).astype(np.float32)
    expected = np.zeros(windows.shape, dtype=np.int64)
    for column, length in enumerate(lengths):
        start, stop = columns.cuts.start[column : column + 2]
        cuts = columns.cuts.cuts[start:stop]
        if length:
            windows[1:4, column] = cuts[generator.integers(len(cuts), size=3)]
        windows[4:7, column] = np.inf, -np.inf, np.nan
        expected[:, column] = np.searchsorted(cuts, windows[:, column], side="right")
        expected[6, column] = 0 if columns.cuts.default_left[column] else 255
    mean, deviation = (0.0,) * len(lengths), (1.0,) * len(lengths)
    scales = Scales.of(
        Normalisation(
            input_mean=mean, input_std=deviation, output_mean=(), output_std=(), folded=bool(seed % 2)
        )
    )
    aligned, ranks = padded_cuts(columns), np.full(windows.shape, 7, dtype=np.int8)
    rank(pack(aligned, scales), windows, ranks)
    np.testing.assert_array_equal(ranks, expected - 128)
