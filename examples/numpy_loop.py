"""Fingertips in a loop of your own, without a simulator: 64 of them bounce on a floor.

    pip install 'taxel[server]'
    python examples/numpy_loop.py --json

Contacts are springs. Episodes of the fingertips end at times of their own; each begins again alone.
"""

import argparse
import json

import numpy as np

import taxel
from taxel.contacts import fingertip_contacts
from taxel.skin import PAD

FINGERS = 64
STEPS = 1000
DT_S = 0.002
MASS_KG = 0.1
RADIUS_M = 0.007
STIFFNESS = 2000.0
"""N/m."""
DAMPING = 6.0
"""N s/m."""


def main() -> None:
    """Let fingertips fall; print what they carry and feel."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--model", default="xgb")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    options = parser.parse_args()
    random = np.random.default_rng(options.seed)
    with taxel.load() as source:
        fingers = source.predictor(options.model).fingers(FINGERS, rate_hz=1.0 / DT_S)
        # The sensor's frames: upright, side by side.
        centre = np.zeros((FINGERS, 3))
        centre[:, 0] = np.arange(FINGERS)
        upright = np.tile(np.eye(3), (FINGERS, 1, 1))
        velocity = np.zeros(FINGERS)
        centre[:, 2] = random.uniform(0.008, 0.02, FINGERS)
        last, forces, pressures, resets = None, [], [], 0
        for _ in range(STEPS):
            # One contact for each fingertip that is in the floor.
            depth = RADIUS_M - centre[:, 2]
            touching = np.flatnonzero(depth > 0.0)
            push = np.zeros((len(touching), 3))
            push[:, 2] = np.maximum(STIFFNESS * depth[touching] - DAMPING * velocity[touching], 0.0)
            points = centre[touching] * [1.0, 1.0, 0.0]
            sample = fingertip_contacts(points, push, centre, upright, finger=touching, last=last)
            last = sample.position
            channels = fingers.step(sample.position, sample.force, DT_S)
            velocity += DT_S * (sample.force[:, 2] / MASS_KG - 9.81)
            centre[:, 2] += DT_S * velocity
            forces.append(sample.force[:, 2])
            pressures.append(channels[:, taxel.CHANNELS.index("pdc")])
            ended = np.flatnonzero(random.random(FINGERS) < 0.002)
            centre[ended, 2], velocity[ended] = random.uniform(0.008, 0.02, len(ended)), 0.0
            last[ended] = PAD
            fingers.reset(ended)
            resets += len(ended)
    # The channels come late: a model that looks ahead waits for what it looks at.
    late = round(fingers.delay_s / DT_S)
    force, pressure = np.array(forces)[: STEPS - late], np.array(pressures)[late:]
    found = {"resets": resets, "weight": MASS_KG * 9.81, "median_force": float(np.median(force))}
    found["pdc_free"] = float(np.median(pressure[force == 0.0]))
    found["pdc_pressed"] = float(np.median(pressure[force > 0.5]))
    if options.json:
        print(json.dumps(found))
    else:
        print(f"{FINGERS} fingertips, {resets} episodes ended; a fingertip weighs {found['weight']:.2f} N,")
        print(f"it carries {found['median_force']:.2f} N in the median.")
        print(f"pdc is {found['pdc_free']:.0f} in the air and {found['pdc_pressed']:.0f} on the floor.")


if __name__ == "__main__":
    main()
