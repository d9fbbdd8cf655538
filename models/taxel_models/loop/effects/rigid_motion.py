"""The rigid motion of a model's inputs that explains most of a residual."""

from itertools import product
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from taxel.corrections import Frame
from taxel.schema import Matrix, Vector
from taxel_models.loop.basis import Floats
from taxel_models.loop.effects.effect import Remaining
from taxel_models.loop.observations import Observations
from taxel_models.model import predict_all

STEP_RAD: Final = np.radians(2.0)
STEP_M: Final = 3e-4
"""Steps of the finite differences: a forest's prediction is constant over smaller steps."""

FIT_ROWS: Final = 3_000
"""All channels share one motion, so it is fitted to at most so many rows."""

STEPS: Final = 8
"""Gauss-Newton steps."""

LESSER_DEG: Final = (25.0, 50.0)
BEST_STARTS: Final = 2
SCANNED: Final = 12
"""Every twelfth row is used to choose the turns from which a fit begins."""


def fit_motion(observations: Observations, remaining: Remaining, kind: str) -> Floats:
    """(3,) the rotation vector, rad, or shift, m, that explains most of the fit part's residual.

    Args:
        kind: what moves; see `turn_of`.
    """
    fit = np.flatnonzero(remaining.fit)
    rows = fit[np.linspace(0, len(fit) - 1, min(len(fit), FIT_ROWS)).astype(np.int64)]
    every = _Misfit(observations, remaining, kind, rows)
    if kind == "shift":
        return _gauss_newton(every, np.zeros(3), STEP_M)[0]
    few = _Misfit(observations, remaining, kind, rows[::SCANNED])
    order = np.argsort([few.of(few.change(turn)) for turn in TURNS])
    near = [_gauss_newton(few, TURNS[place], STEP_RAD) for place in order[:BEST_STARTS]]
    return _gauss_newton(every, min(near, key=lambda fit: fit[1])[0], STEP_RAD)[0]


def _great_turns() -> Floats:
    """(k, 3) rotation vectors, rad: no turn, quarter and half turns, and smaller turns about many axes."""
    corners = np.array([axis for axis in product((-1.0, 0.0, 1.0), repeat=3) if any(axis)])
    axes = corners / np.linalg.norm(corners, axis=1, keepdims=True)
    lesser = np.radians(LESSER_DEG)[:, None, None] * axes
    return np.concatenate([Rotation.create_group("O").as_rotvec(), lesser.reshape(-1, 3)])


TURNS: Final = _great_turns()
"""The starts of fits: if the model is not smooth, small steps do not lead far."""


class _Misfit:
    """How much of a residual a motion leaves at some rows. Rows and channels are weighted."""

    def __init__(
        self, observations: Observations, remaining: Remaining, kind: str, rows: NDArray[np.int64]
    ) -> None:
        self._observations, self._kind = observations, kind
        self._windows, self._still = observations.windows[rows], observations.predicted[rows]
        target = remaining.residual[rows]
        self._counted = np.sqrt(
            remaining.row_weights[rows, None] / np.maximum((target**2).mean(axis=0), 1e-9)
        )
        self.target = target * self._counted

    def change(self, vector: Floats) -> Floats:
        """(n, 21) the change by a motion, weighted as the target is."""
        turned = turn_of(self._kind, vector).turn(self._windows, self._observations.manifest.spec)
        changed = predict_all(self._observations.model.predict, turned) - self._still
        return np.asarray(changed * self._counted)

    def of(self, change: Floats) -> float:
        """The sum of squares that a change leaves."""
        return float(((self.target - change) ** 2).sum())


def _gauss_newton(misfit: _Misfit, vector: Floats, step: float) -> tuple[Floats, float]:
    """The best motion (3,) downhill from a start, by finite differences over a step, and its misfit."""
    change = misfit.change(vector)
    least = misfit.of(change)
    for _ in range(STEPS):
        slopes = np.stack(
            [((misfit.change(vector + axis) - change) / step).ravel() for axis in np.eye(3) * step], axis=1
        )
        towards = np.linalg.lstsq(slopes, (misfit.target - change).ravel(), rcond=None)[0]
        for shorter in (1.0, 0.5, 0.25):
            tried = misfit.change(vector + shorter * towards)
            if misfit.of(tried) < least:
                break
        else:
            break
        vector, change, least = vector + shorter * towards, tried, misfit.of(tried)
        if np.linalg.norm(shorter * towards) < 0.1 * step:
            break
    return vector, least


def turn_of(kind: str, vector: Floats) -> Frame:
    """The motion of a rotation vector (3,) rad, or of a shift (3,) m.

    Args:
        kind: `force`, `position` or `both` are turned, or the position is moved by a `shift`.
    """
    turned = Rotation.from_rotvec(vector).as_matrix() if kind != "shift" else np.eye(3)
    still = np.eye(3)
    return Frame(
        position_rotation=_rows(turned if kind in ("position", "both") else still),
        position_translation=_triple((vector if kind == "shift" else np.zeros(3)).tolist()),
        force_rotation=_rows(turned if kind in ("force", "both") else still),
    )


def after(second: Frame, first: Frame) -> Frame:
    """The composition of two motions: the first, then the second."""
    turned, force = (
        np.array(getattr(second, name)) @ np.array(getattr(first, name))
        for name in ("position_rotation", "force_rotation")
    )
    moved = np.array(second.position_rotation) @ np.array(first.position_translation)
    moved += np.array(second.position_translation)
    return Frame(
        position_rotation=_rows(turned),
        position_translation=_triple(moved.tolist()),
        force_rotation=_rows(force),
    )


def _rows(matrix: Floats) -> Matrix:
    first, second, third = matrix.tolist()
    return (_triple(first), _triple(second), _triple(third))


def _triple(values: list[float]) -> Vector:
    x, y, z = values
    return (x, y, z)
