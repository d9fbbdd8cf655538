"""A BioTac fingertip in PyBullet: it lands on a table, and is pulled along it.

pip install 'taxel[server]' pybullet
python examples/pybullet_fingertip.py --json
"""

import argparse
import json
from typing import Any

import numpy as np
import pybullet

import taxel
from taxel.contacts import ContactSample, fingertip_contacts

TIMESTEP_S = 0.002
MASS_KG = 0.1
PULL_N = 0.2
RADIUS_M = 0.007


def main() -> None:
    """Play the scene and print what the fingertip felt."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--model", default="xgb")
    parser.add_argument("--finger-first", action="store_true", help="make the finger before the table")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    options = parser.parse_args()
    pybullet.connect(pybullet.DIRECT)
    with taxel.load() as source:
        found = play(source.predictor(options.model), options.finger_first)
    pybullet.disconnect()
    if options.json:
        print(json.dumps(found))
    else:
        for name, values in found.items():
            print(f"{name}: {np.round(values, 3)}")


def play(predictor: taxel.Predictor, finger_first: bool) -> dict[str, Any]:
    """Let the fingertip settle for a second, then pull it along y for a second; friction holds it."""
    pybullet.setTimeStep(TIMESTEP_S)
    pybullet.setGravity(0.0, 0.0, -9.81)
    tip, table = (fingertip(), box()) if finger_first else (box(), fingertip())[::-1]
    for body in (table, tip):
        pybullet.changeDynamics(body, -1, lateralFriction=0.6, rollingFriction=0.01)
    fingers = predictor.fingers(1, rate_hz=1.0 / TIMESTEP_S)
    last: np.ndarray | None = None
    for step in range(1000):
        if step >= 500:
            centre, _ = pybullet.getBasePositionAndOrientation(tip)
            pybullet.applyExternalForce(tip, -1, [0.0, PULL_N, 0.0], centre, pybullet.WORLD_FRAME)
        pybullet.stepSimulation()
        sample = touching(tip, last)
        last = sample.position
        channels = fingers.step(sample.position, sample.force)
        if not step:
            rest = channels
    return {
        "force": sample.force[0].tolist(),
        "position": sample.position[0].tolist(),
        "velocity": list(pybullet.getBaseVelocity(tip)[0]),
        "change": (channels - rest)[0].tolist(),
    }


def box() -> int:
    """A table whose top is at z = 0."""
    shape = pybullet.createCollisionShape(pybullet.GEOM_BOX, halfExtents=[0.1, 0.1, 0.01])
    return int(pybullet.createMultiBody(0.0, shape, basePosition=[0.0, 0.0, -0.01]))


def fingertip() -> int:
    """A ball as large as the fingertip, a little above the table."""
    shape = pybullet.createCollisionShape(pybullet.GEOM_SPHERE, radius=RADIUS_M)
    return int(pybullet.createMultiBody(MASS_KG, shape, basePosition=[0.0, 0.0, RADIUS_M + 0.001]))


def touching(body: int, last: np.ndarray | None) -> ContactSample:
    """What touches a body, whose origin is the sensor's frame."""
    points, forces = [], []
    for contact in pybullet.getContactPoints(bodyA=body):
        _, _, other, _, _, on_body, _, normal, _, pressure, friction, along, friction2, along2, *_ = contact
        points.append(on_body)
        # PyBullet turns the normal towards the body that is asked for. It tells the friction on the body
        # of the lower number, whichever is asked for.
        sideways = friction * np.array(along) + friction2 * np.array(along2)
        forces.append(pressure * np.array(normal) + (sideways if body < other else -sideways))
    position, quaternion = pybullet.getBasePositionAndOrientation(body)
    rotation = np.reshape(pybullet.getMatrixFromQuaternion(quaternion), (3, 3))
    return fingertip_contacts(points, forces, position, rotation, last=last)


if __name__ == "__main__":
    main()
