"""Times the steps of a MuJoCo simulation, alone and with fingertips."""

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from taxel.predictor import PredictorSource

TIMESTEP_S: Final = 0.002
LEAST_STEPS: Final = 100
"""Of a figure, however long they take: two hundred milliseconds of simulated time."""

_WARM_UP: Final = 12
"""Steps at least before a measurement: the first ones read the model's memory, two of them predict."""

SPACING_M: Final = 0.05


@dataclass(frozen=True)
class Cell:
    """One measurement.

    Attributes:
        model: what predicts; empty where physics runs alone.
        where: `alone`, `local` (in process) or `remote` (a server on this machine, never waited for).
        steps: how many were timed.
        real_time_factor: simulated time over the time that the steps took.
        mean_us: of a step with all its fingertips; `median_us` and `p99_us` likewise.
    """

    fingers: int
    model: str
    where: str
    steps: int
    real_time_factor: float
    mean_us: float
    median_us: float
    p99_us: float


def scene(fingers: int) -> Any:
    """A `mujoco.MjModel` in which fingertips press a plane, each with a motor of its own."""
    import mujoco

    import taxel.mujoco

    spec = mujoco.MjSpec()
    spec.option.timestep = TIMESTEP_S
    spec.memory = 2**20 * max(16, fingers // 4)
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[1, 1, 1], contype=1, conaffinity=2)
    side = int(np.ceil(np.sqrt(fingers)))
    for number in range(fingers):
        place = [SPACING_M * (number % side), SPACING_M * (number // side), 0.008]
        # Its tip points down by a little, so that one point of it touches.
        body = spec.worldbody.add_body(name=f"finger{number}", pos=place, quat=[0.995, 0, 0.0998, 0])
        body.add_joint(name=f"press{number}", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[0, 0, 1], damping=2)
        body.add_geom(
            type=mujoco.mjtGeom.mjGEOM_CAPSULE,
            fromto=[-0.017, 0, 0, 0, 0, 0],
            size=[0.007, 0, 0],
            mass=0.05,
            contype=2,
            conaffinity=1,
        )
        body.add_site(name=f"site{number}")
        motor = spec.add_actuator(trntype=mujoco.mjtTrn.mjTRN_JOINT, target=f"press{number}")
        motor.set_to_motor()
        taxel.mujoco.add_sensor(spec, f"site{number}")
    return spec.compile()


def measure(
    fingers: int, local: PredictorSource, remote: PredictorSource, models: Sequence[str], seconds: float
) -> Iterator[Cell]:
    """Physics alone, then with each model, in process and behind a server.

    Args:
        seconds: about how long to time each; at least `LEAST_STEPS` steps are.
    """
    import taxel.mujoco

    model = scene(fingers)
    _timed(model, None, seconds / 4, _WARM_UP)
    yield _cell(fingers, "", "alone", _timed(model, None, seconds))
    for name in models:
        for where, source in (("local", local), ("remote", remote)):
            tips = taxel.mujoco.Fingertips(model, source.predictor(name))
            try:
                _timed(model, tips, seconds / 4, _WARM_UP)
                yield _cell(fingers, name, where, _timed(model, tips, seconds))
            finally:
                tips.close()


def _timed(model: Any, tips: Any, seconds: float, least: int = LEAST_STEPS) -> NDArray[np.float64]:
    """Seconds of each step, from the beginning of the simulation."""
    import mujoco

    data = mujoco.MjData(model)
    phases = np.linspace(0.0, 2.0 * np.pi, model.nu, endpoint=False)
    taken: list[float] = []
    until = time.perf_counter() + seconds
    while len(taken) < least or time.perf_counter() < until:
        data.ctrl[:] = -1.0 - np.sin(2.0 * np.pi * data.time + phases)
        start = time.perf_counter()
        mujoco.mj_step(model, data)
        if tips is not None:
            tips.step(data)
        taken.append(time.perf_counter() - start)
    return np.array(taken)


def _cell(fingers: int, model: str, where: str, taken: NDArray[np.float64]) -> Cell:
    return Cell(
        fingers=fingers,
        model=model,
        where=where,
        steps=len(taken),
        real_time_factor=TIMESTEP_S / float(taken.mean()),
        mean_us=1e6 * float(taken.mean()),
        median_us=1e6 * float(np.median(taken)),
        p99_us=1e6 * float(np.percentile(taken, 99)),
    )
