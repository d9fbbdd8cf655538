"""Compares a block of rows with every cut of a forest, once each, however many nodes ask for it."""

from taxel_server.runtimes.compiled.compiling import compiled
from taxel_server.runtimes.trees.simd.bits import not_below


@compiled
def _load_feature(scales, windows, first, feature, x):  # type: ignore[no-untyped-def]
    """A feature of a block of rows, the last row's repeated; place 8 j + k is for lane k lanes / 8 + j."""
    eighth = x.size // 8
    for lane in range(x.size):
        row = min(first + lane, windows.shape[0] - 1)
        x[lane % eighth * 8 + lane // eighth] = windows[row, feature]
    if scales.applied:
        for lane in range(x.size):
            x[lane] = (x[lane] - scales.input_mean[feature]) / scales.input_std[feature]


@compiled
def compare(columns, scales, windows, first, x, comparisons):  # type: ignore[no-untyped-def]
    """Makes all comparisons with a block of rows: a bit is set where a row goes right."""
    values, words = x.ctypes.data, x.size // 64
    feature = -1
    for column in range(columns.feature.size):
        if feature != columns.feature[column]:
            feature = columns.feature[column]
            _load_feature(scales, windows, first, feature, x)
        start, stop = columns.start[column], columns.start[column + 1]
        for word in range(words):
            part = values + 256 * word
            # Two loops: in one, LLVM would choose between their results bit by bit.
            if columns.default_left[column]:
                for place in range(start, stop):
                    comparisons[place * words + word] = not_below(part, columns.cuts[place], False)
            else:
                for place in range(start, stop):
                    comparisons[place * words + word] = not_below(part, columns.cuts[place], True)
