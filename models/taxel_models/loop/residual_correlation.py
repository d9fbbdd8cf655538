"""Correlations of a residual: with its own past, and with the inputs and their past.

What a model explains in full leaves white noise that depends on no input (Ljung 1999, section 16.6;
MATLAB's `resid` draws the same). Both rows of a pair lie in one segment.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from taxel.channels import CHANNELS
from taxel.windows.history import TICK_S
from taxel_models.loop.basis import Floats
from taxel_models.loop.blocks import Blocks
from taxel_models.loop.findings import Autocorrelation, CrossCorrelation
from taxel_models.loop.observations import Observations

LAGS: Final = (1, 2, 3, 5, 10, 20, 30, 50, 100, 200, 300, 500)
"""Ticks: 10 ms to 5 s."""

INPUT_LAGS: Final = tuple(lag for lag in LAGS if lag <= 100)
"""Of inputs, ticks: up to 1 s, since farther rows are mostly of another contact."""

CONFIDENCE: Final = 0.99
_DIGITS: Final = 4


def correlations(observations: Observations, left: Floats, rows: NDArray[np.bool_], lag: int) -> Floats:
    """(21,) autocorrelation of a residual (n, 21) at a lag in ticks; 0 where no rows are so far apart."""
    both = _pairs(observations, rows, lag)
    if not both.any():
        return np.zeros(len(CHANNELS))
    centred = left - left[rows].mean(axis=0)
    products = (centred[lag:][both] * centred[: len(left) - lag][both]).mean(axis=0)
    return np.asarray(products / np.maximum((centred[rows] ** 2).mean(axis=0), 1e-9))


def autocorrelations(
    observations: Observations, before: Floats, after: Floats, rows: NDArray[np.bool_]
) -> Autocorrelation:
    """Of the residuals before and after, (n, 21) counts each."""
    pairs = {lag: int(_pairs(observations, rows, lag).sum()) for lag in LAGS}
    lags = _known(pairs)
    quantile = stats.norm.ppf(0.5 + CONFIDENCE / 2)
    return Autocorrelation(
        lags_s=tuple(round(lag * TICK_S, 2) for lag in lags),
        band=_rounded(quantile / np.sqrt([pairs[lag] for lag in lags])),
        before=_by_channel(np.array([correlations(observations, before, rows, lag) for lag in lags])),
        after=_by_channel(np.array([correlations(observations, after, rows, lag) for lag in lags])),
    )


def cross_correlations(
    observations: Observations, blocks: Blocks, before: Floats, after: Floats
) -> tuple[CrossCorrelation, ...]:
    """Of the residuals before and after, (n, 21) counts each, with every input that varies."""
    rows = blocks.evaluation
    names, inputs = _inputs(observations, rows)
    lags = (0, *_known({lag: int(_pairs(observations, rows, lag).sum()) for lag in INPUT_LAGS}))
    tables, bands = [], []
    for residual in (before, after):
        centred = residual - residual[rows].mean(axis=0)
        scaled = centred / np.maximum(centred[rows].std(axis=0), 1e-9)
        tables.append(np.array([_lagged(observations, scaled, inputs, rows, lag) for lag in lags]))
        bands.append(_band(blocks, scaled, inputs))
    return tuple(
        CrossCorrelation(
            input=name,
            lags_s=tuple(round(lag * TICK_S, 2) for lag in lags),
            before=_by_channel(tables[0][:, :, place]),
            after=_by_channel(tables[1][:, :, place]),
            band_before=dict(zip(CHANNELS, _rounded(bands[0][:, place]), strict=True)),
            band_after=dict(zip(CHANNELS, _rounded(bands[1][:, place]), strict=True)),
        )
        for place, name in enumerate(names)
    )


def _inputs(observations: Observations, rows: NDArray[np.bool_]) -> tuple[list[str], Floats]:
    """Names, and (n, inputs) of mean 0 and SD 1 at the rows."""
    columns = {"force": observations.pressed}
    columns |= {f"force {axis}": observations.force[:, place] for place, axis in enumerate("xyz")}
    columns |= {f"position {axis}": observations.position[:, place] for place, axis in enumerate("xyz")}
    varies = {name: values for name, values in columns.items() if values[rows].std() > 1e-9}
    inputs = np.column_stack(list(varies.values())) if varies else np.empty((len(rows), 0))
    return list(varies), (inputs - inputs[rows].mean(axis=0)) / inputs[rows].std(axis=0)


def _pairs(observations: Observations, rows: NDArray[np.bool_], lag: int) -> NDArray[np.bool_]:
    """(n - lag,) whether a row and the one so many ticks before it are wanted and of one segment."""
    earlier = slice(0, max(len(rows) - lag, 0))
    return np.asarray(
        rows[lag:] & rows[earlier] & (observations.segment[lag:] == observations.segment[earlier])
    )


def _known(pairs: dict[int, int]) -> list[int]:
    """Lags that enough pairs of rows are apart: half of those at the shortest."""
    most = max(pairs.values())
    return [lag for lag, count in pairs.items() if count and 2 * count >= most]


def _lagged(
    observations: Observations, scaled: Floats, inputs: Floats, rows: NDArray[np.bool_], lag: int
) -> Floats:
    """(21, inputs)."""
    both = _pairs(observations, rows, lag)
    return np.asarray(scaled[lag:][both].T @ inputs[: len(rows) - lag][both] / both.sum())


def _band(blocks: Blocks, scaled: Floats, inputs: Floats) -> Floats:
    """(21, inputs) half the width of the interval around 0, from the scatter between blocks.

    Rows of a block may be correlated in any way (Liang and Zeger 1986).
    """
    rows = blocks.evaluation
    numbers = np.unique(blocks.of_row[rows])
    if len(numbers) < 2:
        return np.ones((len(CHANNELS), inputs.shape[1]))
    sums = np.array([scaled[own].T @ inputs[own] for own in (blocks.of_row == one for one in numbers)])
    quantile = stats.t.ppf(0.5 + CONFIDENCE / 2, len(numbers) - 1)
    return np.asarray(quantile * np.sqrt(len(numbers)) * sums.std(axis=0, ddof=1) / rows.sum())


def _by_channel(table: Floats) -> dict[str, tuple[float, ...]]:
    """Of a table (lags, 21)."""
    return {name: _rounded(table[:, place]) for place, name in enumerate(CHANNELS)}


def _rounded(values: Floats) -> tuple[float, ...]:
    """So short that a report stays small."""
    return tuple(round(float(value), _DIGITS) for value in values)
