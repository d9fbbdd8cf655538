"""The motion of a model's inputs that explains most of a residual: they are turned, shifted or scaled."""

from collections.abc import Callable, Sequence
from itertools import product
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from taxel.corrections import Frame
from taxel_models.loop.basis import Basis, Floats
from taxel_models.loop.effects.effect import Remaining
from taxel_models.loop.observations import Observations
from taxel_models.model import predict_all

LEAST_SCALE: Final = 0.1
"""Of forces."""

LEAST_SPREAD_M: Final = 1e-4
"""Along an axis on which all positions are alike."""

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

Parameters = dict[str, tuple[float, str]]


SPREADS: Final = np.concatenate([np.arange(1, 17) / 4, np.arange(9, 17) / 2])
"""Shifts along an axis that are tried, over the spread of the positions along it. A forest does not change
with positions that it never saw, so no small step leads back from there; where its places are heights of
few surfaces, a shift is found only from very near."""


def _great_turns() -> Floats:
    """(k, 3) rotation vectors, rad: no turn, quarter and half turns, and smaller turns about many axes."""
    corners = np.array([axis for axis in product((-1.0, 0.0, 1.0), repeat=3) if any(axis)])
    axes = corners / np.linalg.norm(corners, axis=1, keepdims=True)
    lesser = np.radians(LESSER_DEG)[:, None, None] * axes
    return np.concatenate([Rotation.create_group("O").as_rotvec(), lesser.reshape(-1, 3)])


TURNS: Final = _great_turns()
SCALES: Final = np.linspace(-0.5, 0.75, 11)[:, None]
NOTHING: Final = np.zeros((1, 3))
SHIFTS: Final = np.concatenate(
    [NOTHING, *(size * np.eye(3) for size in np.concatenate([-SPREADS, SPREADS]))]
)
MIRROR: Final = np.diag([-1.0, 1.0, 1.0])
"""What mirrors, with any turn after it."""

STILL: Final[dict[str, Any]] = {
    "position_rotation": ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
    "position_translation": (0.0, 0.0, 0.0),
    "force_rotation": ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
}
"""A frame that changes nothing."""


class MotionKind(NamedTuple):
    """A kind of motion, of which each is a vector.

    Attributes:
        name: in words.
        starts: (k, 3) or (k, 1), where fits begin: if the model is not smooth, small steps do not lead far.
        step: of the finite differences: a forest's prediction is constant over smaller steps.
        frame: the motion of a vector.
        parameters: of a vector, for a report, with their units.
        by_spread: whether starts and step are in units of the spread of the positions along each axis.
    """

    name: str
    starts: Floats
    step: float
    frame: Callable[[Floats], Frame]
    parameters: Callable[[Floats], Parameters]
    by_spread: bool = False


def _turn(name: str, *parts: str) -> MotionKind:
    """Turns of some parts of a frame: vectors are rotation vectors (3,), rad."""

    def frame(vector: Floats) -> Frame:
        return _with(Rotation.from_rotvec(vector).as_matrix(), parts)

    def parameters(vector: Floats) -> Parameters:
        angle = float(np.degrees(np.linalg.norm(vector)))
        return {"angle": (angle, "deg"), **_by_axis("", np.degrees(vector), "deg")}

    return MotionKind(name, TURNS, float(np.radians(2.0)), frame, parameters)


def _mirrored(name: str, *parts: str) -> MotionKind:
    """One axis of some parts has the wrong sign, and they may be turned, too: vectors as of `_turn`."""

    def turned(vector: Floats) -> Floats:
        return np.asarray(Rotation.from_rotvec(vector).as_matrix() @ MIRROR)

    def parameters(vector: Floats) -> Parameters:
        matrix = turned(vector)
        # A reflection turns nothing: its trace is 1, and it turns the normal round.
        angle = np.degrees(np.arccos(np.clip((np.trace(matrix) + 1.0) / 2.0, -1.0, 1.0)))
        _, _, directions = np.linalg.svd(matrix + np.eye(3))
        normal = directions[-1] * np.sign(directions[-1][np.abs(directions[-1]).argmax()])
        return {**_by_axis("mirrored axis ", normal, ""), "angle": (float(angle), "deg")}

    step = float(np.radians(2.0))
    return MotionKind(name, TURNS, step, lambda vector: _with(turned(vector), parts), parameters)


def _with(matrix: Floats, parts: Sequence[str]) -> Frame:
    """A frame that turns some of its parts by a matrix (3, 3)."""
    return Frame(**{**STILL, **dict.fromkeys(parts, matrix.tolist())})


def _by_axis(what: str, vector: Floats, unit: str) -> Parameters:
    return {f"{what}{axis}": (float(value), unit) for axis, value in zip("xyz", vector, strict=True)}


def _shifted(vector: Floats) -> Frame:
    return Frame(**{**STILL, "position_translation": vector.tolist()})


def _pushed(vector: Floats) -> Frame:
    return Frame(**STILL, force_translation=vector.tolist())


def _scaled(vector: Floats) -> Frame:
    return Frame(**STILL, force_scale=max(1.0 + float(vector[0]), LEAST_SCALE))


MOTION_KINDS: Final = (
    _turn("forces turned", "force_rotation"),
    _turn("positions turned", "position_rotation"),
    MotionKind(
        "positions shifted",
        SHIFTS,
        0.1,
        _shifted,
        lambda vector: _by_axis("", vector * 1e3, "mm"),
        by_spread=True,
    ),
    _turn("both turned alike", "position_rotation", "force_rotation"),
    # As by a force sensor's wrong zero, and by its wrong gain.
    _mirrored("forces mirrored", "force_rotation"),
    _mirrored("positions mirrored", "position_rotation"),
    _mirrored("both mirrored alike", "position_rotation", "force_rotation"),
    MotionKind("forces shifted", NOTHING, 0.1, _pushed, lambda vector: _by_axis("force ", vector, "N")),
    MotionKind(
        "forces scaled",
        SCALES,
        0.03,
        _scaled,
        lambda vector: {"force scale": (_scaled(vector).force_scale, "")},
    ),
)
"""What moves: shifts are in m, or N for forces; a scale changes by its vector (1,)."""


class Motion(NamedTuple):
    """A motion of the inputs.

    Attributes:
        kind: what moves.
        vector: (3,) or (1,), see `MOTION_KINDS`.
        explained: what it takes off the squares of the fit part, see `Misfit`.
    """

    kind: MotionKind
    vector: Floats
    explained: float

    @property
    def frame(self) -> Frame:
        """What moves the inputs."""
        return self.kind.frame(self.vector)


def fit_motion(observations: Observations, remaining: Remaining) -> Motion | None:
    """The motion that explains most of the fit part's residual; None if none explains anything."""
    rows = rows_of(remaining.fit)
    every, few, scan = (Misfit(observations, remaining, rows[::step]) for step in (1, FEW, FEW * SCANNED))
    rough: list[Motion] = []
    for kind in MOTION_KINDS:
        starts = kind.starts * every.unit(kind)
        if len(starts) > BEST_STARTS:
            starts = starts[np.argsort(scan.of(scan.changes(kind, starts)))[:BEST_STARTS]]
        near = [_gauss_newton(few, kind, start, ROUGH_STEPS) for start in starts]
        rough.append(max(near, key=lambda motion: motion.explained))
    most = max(motion.explained for motion in rough)
    if most <= 0:
        return None
    found = [
        _gauss_newton(every, motion.kind, motion.vector, STEPS)
        for motion in rough
        if motion.explained >= AS_GOOD * most
    ]
    return max(found, key=lambda motion: motion.explained)


class Misfit:
    """How much of a residual a motion leaves at some rows. Rows and channels are weighted.

    The weights of named effects are fitted together with the motion (variable projection, Golub and Pereyra
    1973): what their regressors explain counts neither in the residual nor in a change.

    Attributes:
        target: (n, 21) the residual.
        energy: its sum of squares.
    """

    def __init__(self, observations: Observations, remaining: Remaining, rows: NDArray[np.int64]) -> None:
        self._observations = observations
        self._windows, self._still = observations.windows[rows], observations.predicted[rows]
        target = remaining.residual[rows]
        self._counted = np.sqrt(
            remaining.row_weights[rows, None] / np.maximum((target**2).mean(axis=0), 1e-9)
        )
        self._directions = _directions(remaining.beside, rows, self._counted)
        self.target = self._without(target * self._counted)
        self.energy = float((self.target**2).sum())

    def unit(self, kind: MotionKind) -> Floats:
        """What a kind's starts and steps are multiples of, (3,) or a number."""
        if not kind.by_spread:
            return np.ones(())
        return np.asarray(np.maximum(self._observations.position.std(axis=0), LEAST_SPREAD_M))

    def changes(self, kind: MotionKind, vectors: Floats) -> Floats:
        """(k, n, 21) the change by each motion (k, 3) or (k, 1) of a kind, weighted as the target is."""
        spec = self._observations.manifest.spec
        turned = np.concatenate([kind.frame(vector).turn(self._windows, spec) for vector in vectors])
        answers = predict_all(self._observations.model.predict, turned)
        return self.weighted(answers.reshape(len(vectors), *self._still.shape) - self._still)

    def weighted(self, changes: Floats) -> Floats:
        """Changes (..., n, 21), counts, weighted as the target is, less what named effects explain."""
        return self._without(np.asarray(changes * self._counted))

    def _without(self, values: Floats) -> Floats:
        channels = np.moveaxis(values, -1, 0).reshape(values.shape[-1], -1, values.shape[-2])
        inside = (channels @ self._directions) @ self._directions.swapaxes(1, 2)
        return values - np.moveaxis(inside, 0, -1).reshape(values.shape)

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


def _gauss_newton(misfit: Misfit, kind: MotionKind, vector: Floats, steps: int) -> Motion:
    """The best motion downhill from a start (3,) or (1,), by finite differences."""
    step = np.broadcast_to(kind.step * misfit.unit(kind), vector.shape)
    change = misfit.changes(kind, vector[None])[0]
    least = float(misfit.of(change[None])[0])
    for _ in range(steps):
        moved = misfit.changes(kind, vector + np.eye(len(vector)) * step)
        slopes = ((moved - change) / step[:, None, None]).reshape(len(vector), -1).T
        towards = np.linalg.lstsq(slopes, (misfit.target - change).ravel(), rcond=None)[0]
        for shorter in (1.0, 0.5, 0.25):
            tried = misfit.changes(kind, (vector + shorter * towards)[None])[0]
            left = float(misfit.of(tried[None])[0])
            if left < least:
                break
        else:
            break
        small = least - left < ENOUGH * misfit.energy
        vector, change, least = vector + shorter * towards, tried, left
        if small or np.linalg.norm(shorter * towards / step) < 0.1:
            break
    return Motion(kind, vector, misfit.energy - least)
