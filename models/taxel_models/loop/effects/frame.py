"""Frame: the frame of the recorded forces or positions is turned or shifted."""

from collections.abc import Iterable
from functools import partial
from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation
from typing_extensions import override

from taxel_models.loop.basis import Floats, Own
from taxel_models.loop.effects.effect import Candidate, Effect, Left
from taxel_models.loop.evidence import Evidence, predict_all
from taxel_models.loop.moments import Fitting
from taxel_models.loop.planting import Planting
from taxel_models.loop.rigid_motion import after, fit_motion, turn_of

TEST_ROWS: Final = 8_000
"""A motion common to all channels needs no more rows than these."""

MOST_DEG: Final = 45.0
LIGHT_DEG: Final = 15.0
"""Of the forces: about what a strength of 1 stands for. A turn of inputs cannot be scaled to a residual."""

KINDS: Final = {
    "forces turned": "force",
    "positions turned": "position",
    "positions shifted": "shift",
    "both turned alike": "both",
}


class Frame(Effect):
    """A rigid motion between the recorded frame and the model's, common to all channels."""

    name = "frame"
    looks_at_residual = True
    equation = "measured = model(R x + t, Q F)"
    source = "rigid motion; Gauss-Newton on finite differences of the model"
    signature = "turning or shifting the inputs explains all channels with three common figures"

    @override
    def forms(self, evidence: Evidence, left: Left) -> Iterable[Candidate]:
        rows = np.linspace(0, len(evidence) - 1, min(len(evidence), TEST_ROWS)).astype(np.int64)
        for form, kind in KINDS.items():
            vector = fit_motion(evidence, left, kind)
            turned = turn_of(kind, vector).turn(evidence.windows[rows], evidence.manifest.spec)
            change = predict_all(evidence.predict, turned) - evidence.predicted[rows]
            yield Candidate(
                self.name,
                form,
                Own(change[:, :, None].astype(np.float32), rows),
                fitting=Fitting(fixed=True),
                settled=_settled(kind, vector),
                moved=partial(_moved, kind, vector),
            )

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


def _settled(kind: str, vector: Floats) -> dict[str, tuple[float, str]]:
    """The motion's figures, for people."""
    if kind == "shift":
        named = dict(zip("xyz", vector * 1e3, strict=True))
        return {name: (float(value), "mm") for name, value in named.items()}
    named = dict(zip("xyz", np.degrees(vector), strict=True))
    angle = float(np.degrees(np.linalg.norm(vector)))
    return {"angle": (angle, "deg"), **{name: (float(value), "deg") for name, value in named.items()}}


def _moved(kind: str, vector: Floats, evidence: Evidence) -> Evidence:
    """The evidence with its windows turned, or turned further."""
    turn = turn_of(kind, vector)
    windows = turn.turn(evidence.windows, evidence.manifest.spec)
    whole = turn if evidence.turn is None else after(turn, evidence.turn)
    return evidence.with_windows(windows, turn=whole, shift_ticks=evidence.shift_ticks)
