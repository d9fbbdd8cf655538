"""The motion of a model's inputs that explains most of a residual: they are turned, shifted or scaled."""

from collections.abc import Sequence
from itertools import product
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from taxel.corrections import Frame
from taxel.schema import Matrix, Vector
from taxel_models.loop.basis import Basis, Floats
from taxel_models.loop.effects.effect import Remaining
from taxel_models.loop.observations import Observations
from taxel_models.model import predict_all

STEP_RAD: Final = np.radians(2.0)
STEP_M: Final = 3e-4
STEP_N: Final = 0.1
STEP_SCALE: Final = 0.03
"""Steps of the finite differences: a forest's prediction is constant over smaller steps."""

LEAST_SCALE: Final = 0.1
"""Of forces."""

FIT_ROWS: Final = 2_400
"""All channels share one motion, so it is fitted to at most so many rows."""

STEPS: Final = 8
"""Gauss-Newton steps."""

ENOUGH: Final = 1e-3
"""A step that takes off a smaller share of the squares is the last one."""

LESSER_DEG: Final = (25.0, 50.0)
BEST_STARTS: Final = 2
FEW: Final = 8
"""Every eighth row chooses what moves."""

SCANNED: Final = 2
"""Every second of these chooses the turns from which a fit begins."""

ROUGH_STEPS: Final = 4
AS_GOOD: Final = 0.8
"""Kinds of motion that explain this share of what the best one explains of few rows are fitted to all."""

TURNED: Final = ("force", "position", "both")
KINDS: Final = ("force", "position", "shift", "both", "zero", "scale")
"""What moves: forces, positions or both are turned; positions are shifted; forces are shifted, as by a
force sensor's wrong zero, or scaled, as by its wrong gain."""


class Motion(NamedTuple):
    """A motion of the inputs.

    Attributes:
        kind: what moves, one of `KINDS`.
        vector: the rotation vector (3,), rad, the shift (3,), m or N, or the change of the scale (1,).
        explained: what it takes off the squares of the fit part, see `Misfit`.
    """

    kind: str
    vector: Floats
    explained: float


def fit_motion(observations: Observations, remaining: Remaining) -> Motion | None:
    """The motion that explains most of the fit part's residual; None if none explains anything."""
    rows = rows_of(remaining.fit)
    rough: list[tuple[float, str, Floats]] = []
    for kind in KINDS:
        few = Misfit(observations, remaining, kind, rows[::FEW])
        starts = _starts(kind)
        if len(starts) > BEST_STARTS:
            scan = Misfit(observations, remaining, kind, rows[:: FEW * SCANNED])
            starts = starts[np.argsort(scan.of(scan.changes(starts)))[:BEST_STARTS]]
        near = [_gauss_newton(few, start, _step(kind), ROUGH_STEPS) for start in starts]
        vector, least = min(near, key=lambda found: found[1])
        rough.append((1.0 - least / max(few.energy, 1e-12), kind, vector))
    most = max(share for share, _, _ in rough)
    if most <= 0:
        return None
    found = []
    for share, kind, start in rough:
        if share >= AS_GOOD * most:
            every = Misfit(observations, remaining, kind, rows)
            vector, least = _gauss_newton(every, start, _step(kind), STEPS)
            found.append(Motion(kind, vector, every.energy - least))
    return max(found, key=lambda motion: motion.explained)


def _step(kind: str) -> float:
    if kind in TURNED:
        return float(STEP_RAD)
    return {"shift": STEP_M, "zero": STEP_N, "scale": STEP_SCALE}[kind]


def _great_turns() -> Floats:
    """(k, 3) rotation vectors, rad: no turn, quarter and half turns, and smaller turns about many axes."""
    corners = np.array([axis for axis in product((-1.0, 0.0, 1.0), repeat=3) if any(axis)])
    axes = corners / np.linalg.norm(corners, axis=1, keepdims=True)
    lesser = np.radians(LESSER_DEG)[:, None, None] * axes
    return np.concatenate([Rotation.create_group("O").as_rotvec(), lesser.reshape(-1, 3)])


TURNS: Final = _great_turns()
SCALES: Final = np.linspace(-0.5, 0.75, 11)[:, None]
"""The starts of fits: if the model is not smooth, small steps do not lead far."""


def _starts(kind: str) -> Floats:
    """(k, 3) or (k, 1) where fits of a kind of motion may begin."""
    if kind in TURNED:
        return TURNS
    return SCALES if kind == "scale" else np.zeros((1, 3))


class Misfit:
    """How much of a residual a motion leaves at some rows. Rows and channels are weighted.

    The weights of named effects are fitted together with the motion (variable projection, Golub and Pereyra
    1973): what their regressors explain counts neither in the residual nor in a change.

    Attributes:
        target: (n, 21) the residual.
        energy: its sum of squares.
    """

    def __init__(
        self, observations: Observations, remaining: Remaining, kind: str, rows: NDArray[np.int64]
    ) -> None:
        self._observations, self._kind = observations, kind
        self._windows, self._still = observations.windows[rows], observations.predicted[rows]
        target = remaining.residual[rows]
        self._counted = np.sqrt(
            remaining.row_weights[rows, None] / np.maximum((target**2).mean(axis=0), 1e-9)
        )
        self._directions = _directions(remaining.beside, rows, self._counted)
        self.target = self._without(target * self._counted)
        self.energy = float((self.target**2).sum())

    def changes(self, vectors: Floats) -> Floats:
        """(k, n, 21) the change by each motion (k, 3) or (k, 1), weighted as the target is."""
        spec = self._observations.manifest.spec
        turned = np.concatenate(
            [turn_of(self._kind, vector).turn(self._windows, spec) for vector in vectors]
        )
        answers = predict_all(self._observations.model.predict, turned)
        return self.weighted(answers.reshape(len(vectors), *self._still.shape) - self._still)

    def weighted(self, changes: Floats) -> Floats:
        """Changes (..., n, 21), counts, weighted as the target is, less what named effects explain."""
        return self._without(np.asarray(changes * self._counted))

    def _without(self, values: Floats) -> Floats:
        inside = np.einsum("cnk,...nc->...ck", self._directions, values)
        return np.asarray(values - np.einsum("cnk,...ck->...nc", self._directions, inside))

    def of(self, changes: Floats) -> Floats:
        """(k,) the sum of squares that each change leaves."""
        return np.asarray(((self.target - changes) ** 2).sum(axis=(1, 2)))


def _directions(beside: Sequence[Basis], rows: NDArray[np.int64], counted: Floats) -> Floats:
    """(21, n, k) orthogonal directions of length 1 that regressors have at some rows, weighted (n, 21)."""
    channels = counted.shape[1]
    values = [np.broadcast_to(basis.at(rows), (channels, len(rows), basis.size)) for basis in beside]
    if not values:
        return np.zeros((channels, len(rows), 0))
    directions, _ = np.linalg.qr(np.concatenate(values, axis=2) * counted.T[:, :, None])
    return np.asarray(directions)


def rows_of(fit: NDArray[np.bool_]) -> NDArray[np.int64]:
    """(m,) the rows of the fit part (n,) that a motion is fitted to."""
    rows = np.flatnonzero(fit)
    return rows[np.linspace(0, len(rows) - 1, min(len(rows), FIT_ROWS)).astype(np.int64)]


def _gauss_newton(misfit: Misfit, vector: Floats, step: float, steps: int) -> tuple[Floats, float]:
    """The best motion (3,) or (1,) downhill from a start, by finite differences, and its misfit."""
    change = misfit.changes(vector[None])[0]
    least = float(misfit.of(change[None])[0])
    for _ in range(steps):
        moved = misfit.changes(vector + np.eye(len(vector)) * step)
        slopes = ((moved - change) / step).reshape(len(vector), -1).T
        towards = np.linalg.lstsq(slopes, (misfit.target - change).ravel(), rcond=None)[0]
        for shorter in (1.0, 0.5, 0.25):
            tried = misfit.changes((vector + shorter * towards)[None])[0]
            left = float(misfit.of(tried[None])[0])
            if left < least:
                break
        else:
            break
        small = least - left < ENOUGH * misfit.energy
        vector, change, least = vector + shorter * towards, tried, left
        if small or np.linalg.norm(shorter * towards) < 0.1 * step:
            break
    return vector, least


def turn_of(kind: str, vector: Floats) -> Frame:
    """The motion of a rotation vector (3,) rad, of a shift (3,) m or N, or of a change of the scale (1,).

    Args:
        kind: what moves, one of `KINDS`.
    """
    turned = Rotation.from_rotvec(vector).as_matrix() if kind in TURNED else np.eye(3)
    still = np.eye(3)
    return Frame(
        position_rotation=_rows(turned if kind in ("position", "both") else still),
        position_translation=_triple((vector if kind == "shift" else np.zeros(3)).tolist()),
        force_rotation=_rows(turned if kind in ("force", "both") else still),
        force_translation=_triple((vector if kind == "zero" else np.zeros(3)).tolist()),
        force_scale=max(1.0 + float(vector[0]), LEAST_SCALE) if kind == "scale" else 1.0,
    )


def after(second: Frame, first: Frame) -> Frame:
    """The composition of two motions: the first, then the second."""
    turned, force = (
        np.array(getattr(second, name)) @ np.array(getattr(first, name))
        for name in ("position_rotation", "force_rotation")
    )
    moved = np.array(second.position_rotation) @ np.array(first.position_translation)
    moved += np.array(second.position_translation)
    pushed = second.force_scale * np.array(second.force_rotation) @ np.array(first.force_translation)
    pushed += np.array(second.force_translation)
    return Frame(
        position_rotation=_rows(turned),
        position_translation=_triple(moved.tolist()),
        force_rotation=_rows(force),
        force_translation=_triple(pushed.tolist()),
        force_scale=second.force_scale * first.force_scale,
    )


def _rows(matrix: Floats) -> Matrix:
    first, second, third = matrix.tolist()
    return (_triple(first), _triple(second), _triple(third))


def _triple(values: list[float]) -> Vector:
    x, y, z = values
    return (x, y, z)
