"""Frame: the frame of the recorded forces or positions is turned or shifted."""

from collections.abc import Iterable
from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation
from typing_extensions import override

from taxel.corrections import Frame as Turn
from taxel.parts import Matrix, Vector
from taxel_models.loop.basis import Floats, Own
from taxel_models.loop.effects.effect import Candidate, Effect, Left
from taxel_models.loop.evidence import Evidence, predict_all
from taxel_models.loop.moments import Fitting
from taxel_models.loop.planting import Planting

STEP_RAD: Final = np.radians(2.0)
STEP_M: Final = 3e-4
"""Steps of the finite differences: trees are constant over smaller ones."""

MOST_ROWS: Final = 8_000
"""A motion common to all channels needs no more rows than these."""

MOST_DEG: Final = 45.0
LIGHT_DEG: Final = 15.0
"""Of the forces: about what a strength of 1 stands for. A turn of inputs cannot be scaled to a residual."""

KINDS: Final = {
    "forces turned": ("force",),
    "positions turned": ("position",),
    "positions shifted": ("shift",),
    "both turned alike": ("both",),
}


class Frame(Effect):
    """A rigid motion between the recorded frame and the model's, common to all channels."""

    name = "frame"
    equation = "measured = model(R x + t, Q F)"
    source = "rigid motion; Gauss-Newton on finite differences of the model"
    signature = "turning or shifting the inputs explains all channels with three common figures"

    @override
    def forms(self, evidence: Evidence, left: Left) -> Iterable[Candidate]:
        rows = np.linspace(0, len(evidence) - 1, min(len(evidence), MOST_ROWS)).astype(np.int64)
        changes: dict[str, list[Floats]] = {"force": [], "position": [], "shift": [], "both": []}
        for kind, columns in changes.items():
            step = STEP_M if kind == "shift" else STEP_RAD
            for axis in range(3):
                turn = turn_of(kind, np.eye(3)[axis] * step)
                turned = turn.turn(evidence.windows[rows], evidence.manifest.spec)
                columns.append((predict_all(evidence.predict, turned) - evidence.predicted[rows]) / step)
        for form, kinds in KINDS.items():
            columns = [column for kind in kinds for column in changes[kind]]
            shifted = kinds == ("shift",)
            yield Candidate(
                self.name,
                form,
                Own(np.stack(columns, axis=2).astype(np.float32), rows),
                fitting=Fitting(pooled=True),
                weight_names=("x", "y", "z"),
                weight_unit="m" if shifted else "rad",
                moves=True,
            )

    @override
    def moved(self, evidence: Evidence, candidate: Candidate, weights: Floats) -> Evidence:
        kind = KINDS[candidate.form][0]
        turn = turn_of(kind, weights[0])
        windows = turn.turn(evidence.windows, evidence.manifest.spec)
        whole = turn if evidence.turn is None else after(turn, evidence.turn)
        return evidence.with_windows(windows, turn=whole, shift_ticks=evidence.shift_ticks)

    @override
    def plant(self, planting: Planting) -> None:
        samples = planting.recording.samples
        axis = planting.random.normal(size=3)
        axis /= np.linalg.norm(axis)
        angle = _angle(planting, axis)
        force = Rotation.from_rotvec(axis * np.radians(angle)).apply(samples.force)
        planting.move(samples.position, force, angle=angle, unit="deg")


def _angle(planting: Planting, axis: Floats) -> float:
    """Degrees that make the strength, by what a model answers; in proportion to it without one."""
    samples = planting.recording.samples
    if planting.respond is None:
        return LIGHT_DEG * planting.strength
    still = planting.respond(samples.position, samples.force)
    angles = np.geomspace(1.0, MOST_DEG, 12)
    strengths = [
        planting.strength_of(
            planting.respond(
                samples.position, Rotation.from_rotvec(axis * np.radians(angle)).apply(samples.force)
            )
            - still
        )
        for angle in angles
    ]
    return float(angles[np.argmin(np.abs(np.log(np.maximum(strengths, 1e-9) / planting.strength)))])


def turn_of(kind: str, vector: Floats) -> Turn:
    """The motion of a rotation vector (3,) rad, or of a shift (3,) m."""
    turned = Rotation.from_rotvec(vector).as_matrix() if kind != "shift" else np.eye(3)
    still = np.eye(3)
    return Turn(
        position_rotation=_rows(turned if kind in ("position", "both") else still),
        position_translation=_triple((vector if kind == "shift" else np.zeros(3)).tolist()),
        force_rotation=_rows(turned if kind in ("force", "both") else still),
    )


def after(second: Turn, first: Turn) -> Turn:
    """One motion that does what the two do, one after the other."""
    turned, force = (
        np.array(getattr(second, name)) @ np.array(getattr(first, name))
        for name in ("position_rotation", "force_rotation")
    )
    moved = np.array(second.position_rotation) @ np.array(first.position_translation)
    moved += np.array(second.position_translation)
    return Turn(
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
