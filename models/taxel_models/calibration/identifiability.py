"""Finds which components the contacts determine, from the Jacobian of their distances to the skin.

The covariance of a least-squares estimate is s² (JᵀJ)⁻¹, where s is the standard deviation of the
residuals. If the standard error of a component moves the contacts by more than a limit, the contacts
do not determine it. Such a component is held fixed instead of reported.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from taxel_models.calibration.motion import ANGLES, RIGID

LIMIT_MM: Final = 0.5
"""A component is determined if its standard error moves the contacts by less than this."""

_LEAST_SD_MM: Final = 0.01
"""The least SD of the residuals: no tracker is better."""

_AS_LOOSE: Final = 0.5
"""If two components can replace each other, their errors are about equal. The later one is held."""


def undetermined(
    jacobian: NDArray[np.float64], residuals: NDArray[np.float64], known: NDArray[np.float64], lever: float
) -> int | None:
    """The index of the free component to hold next; None if all are determined.

    Args:
        jacobian: (n, free components), mm by mm or rad.
        residuals: (n,), mm.
        known: (k,), NaN for the components that the columns stand for.
        lever: root-mean-square distance of the contacts from their centre, mm: the lever of an angle.
    """
    places = np.flatnonzero(np.isnan(known))
    if not len(places):
        return None
    angles = [RIGID.index(name) for name in ANGLES]
    moves = np.where(np.isin(places, angles), lever, 1.0)
    errors = standard_errors(jacobian / moves, residuals)
    loosest = float(errors.max())
    if loosest < LIMIT_MM:
        return None
    return int(places[np.flatnonzero(errors >= _AS_LOOSE * loosest)[-1]])


def standard_errors(jacobian: NDArray[np.float64], residuals: NDArray[np.float64]) -> NDArray[np.float64]:
    """Standard error of each column's component, from s² (JᵀJ)⁻¹; infinite if no residual depends on it."""
    rows, columns = jacobian.shape
    _, sizes, directions = np.linalg.svd(jacobian, full_matrices=False)
    tiny = rows * np.finfo(float).eps * sizes[0]
    inverse = np.where(sizes > tiny, 1.0 / np.maximum(sizes, tiny), np.inf)
    # 0 · inf: nothing depends on this direction, and the component has no share in it.
    shares = np.where(np.abs(directions) > 1e-6, directions, 0.0)
    with np.errstate(invalid="ignore"):
        parts = np.nan_to_num(shares * inverse[:, None], nan=0.0, posinf=np.inf, neginf=-np.inf)
    return np.asarray(residual_sd(residuals, columns) * np.sqrt((parts**2).sum(axis=0)))


def residual_sd(residuals: NDArray[np.float64], fitted: float) -> float:
    """The residuals' standard deviation, mm, estimated from their median size, which is robust to outliers.

    Args:
        residuals: (n,), mm.
        fitted: the number of fitted parameters.
    """
    rows = len(residuals)
    raw = 1.4826 * float(np.median(np.abs(residuals))) * np.sqrt(rows / max(rows - fitted, 1.0))
    return max(float(raw), _LEAST_SD_MM)
