"""What was recorded of the contact is wrong: the finger turns in its mounting; the force sensor drifts."""

from collections.abc import Callable
from typing import Any, Final

import numpy as np
from scipy.spatial.transform import Rotation

from taxel_models.foreign.injection import Floats, ForeignInjection

MOST_DEG: Final = 45.0
MOST_N: Final = 3.0
MOST_SCALE: Final = 1.6


def turned_mounting(injection: ForeignInjection) -> None:
    """The finger is mounted at an angle."""
    axis = _direction(injection)
    _move(injection, lambda degrees: _turned(injection, np.radians(degrees) * axis), "angle", MOST_DEG)


def slipped_mounting(injection: ForeignInjection) -> None:
    """In the course of the recording the finger turns in its mounting; what is recorded does not."""
    random, axis = injection.random, _direction(injection)
    begins = float(random.uniform(0.15, 0.5)) * injection.time_s[-1]
    takes = float(random.uniform(0.02, 0.3)) * injection.time_s[-1]
    course = np.clip((injection.time_s - begins) / takes, 0.0, 1.0)[:, None]
    _move(
        injection,
        lambda degrees: _turned(injection, np.radians(degrees) * course * axis),
        "angle",
        MOST_DEG,
    )


def force_zero(injection: ForeignInjection) -> None:
    """The force sensor does not read 0 without a load, as after it was mounted anew or has warmed."""
    samples, axis = injection.recording.samples, _direction(injection)
    _move(injection, lambda newtons: (samples.position, samples.force + newtons * axis), "newtons", MOST_N)


def force_gain(injection: ForeignInjection) -> None:
    """The force sensor reads too much or too little, as with another sensor's calibration."""
    samples, sign = injection.recording.samples, injection.random.choice([-1.0, 1.0])

    def scaled(more: float) -> tuple[Floats, Floats]:
        return samples.position, samples.force * (1.0 + more) ** sign

    _move(injection, scaled, "more", MOST_SCALE - 1.0)


def _direction(injection: ForeignInjection) -> Floats:
    """(3,) of length 1."""
    axis = injection.random.standard_normal(3)
    return np.asarray(axis / np.linalg.norm(axis))


def _turned(injection: ForeignInjection, vector: Floats) -> tuple[Floats, Floats]:
    """The inputs turned by rotation vectors (3,) or (n, 3), rad: positions only if they lie on the skin."""
    turn, samples = Rotation.from_rotvec(vector), injection.recording.samples
    position = turn.apply(samples.position) if injection.on_skin else samples.position
    return position, turn.apply(samples.force)


def _move(
    injection: ForeignInjection, moved: Callable[[float], tuple[Floats, Floats]], name: str, most: float
) -> None:
    """Replace the inputs by moved ones, so far that the model's answers change by the strength.

    Args:
        moved: the positions and forces (n, 3) of a size.
        name: of the size.
        most: the largest size.
    """
    samples = injection.recording.samples
    still, size, reached = injection.respond(samples.position, samples.force), 0.2 * most, 0.0
    # The change is nearly in proportion to the size: a few steps find it.
    for _ in range(3):
        size = float(np.clip(size * injection.strength / reached if reached else size, 0.02 * most, most))
        reached = injection.strength_of(injection.respond(*moved(size)) - still)
    parameters: dict[str, Any] = {name: size, "reached": reached}
    injection.replace_inputs(*moved(size), **parameters)
