"""A BioTac fingertip in MuJoCo at 1 kHz: pressed on a box, and slid over it.

    pip install 'taxel[server,mujoco,plot]'
    python examples/mujoco_fingertip.py --plot fingertip.png
    python examples/mujoco_fingertip.py --json

With `--connect tcp/127.0.0.1:7447` a server predicts, and no step waits for it.
"""

import argparse
import json
import time

import mujoco
import numpy as np

import taxel
import taxel.mujoco
from taxel.predictor import DEFAULT_MODEL

SCENE = """
<mujoco>
  <option timestep="0.001"/>
  <worldbody>
    <geom name="box" type="box" size="0.05 0.05 0.01" pos="0 0 -0.01" friction="0.6"/>
    <body name="finger" pos="-0.005 0 0.009">
      <joint name="slide" type="slide" axis="1 0 0" damping="2"/>
      <joint name="press" type="slide" axis="0 0 1" damping="2"/>
      <geom name="tip" type="capsule" fromto="-0.017 0 0 0 0 0" size="0.007" mass="0.05" friction="0.6"/>
      <site name="biotac" pos="0 0 0"/>
    </body>
  </worldbody>
  <actuator>
    <motor joint="press"/>
    <position joint="slide" kp="200" kv="5"/>
  </actuator>
</mujoco>
"""
STEPS = 4000


def main() -> None:
    """Play the scene without and with the fingertip."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--model", default=DEFAULT_MODEL)
    parser.add_argument(
        "--connect", metavar="ENDPOINT", help="ask a server; without it, predict in this process"
    )
    parser.add_argument("--plot", metavar="PNG", help="draw force and channels")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    options = parser.parse_args()
    source = taxel.connect(options.connect) if options.connect else taxel.load()
    with source:
        spec = mujoco.MjSpec.from_string(SCENE)
        sensor = taxel.mujoco.add_sensor(spec, site="biotac")
        model = spec.compile()
        play(model, None, sensor)  # the first run reads the model's memory
        alone = play(model, None, sensor)
        tips = taxel.mujoco.Fingertips(model, source.predictor(options.model))
        play(model, tips, sensor)
        sensed = play(model, tips, sensor)
        tips.close()
    report(alone, sensed, options.json)
    if options.plot:
        draw(sensed, options.plot)


class Run:
    """What one run measured: seconds a step, and at each step the force (N) and the channels (counts)."""

    def __init__(self) -> None:
        self.seconds = np.zeros(STEPS)
        self.force = np.zeros((STEPS, 3))
        self.channels = np.zeros((STEPS, len(taxel.CHANNELS)))


def play(model: mujoco.MjModel, tips: "taxel.mujoco.Fingertips | None", sensor: str) -> Run:
    """Press for two seconds, then slide."""
    data, run = mujoco.MjData(model), Run()
    for step in range(STEPS):
        moment = step * model.opt.timestep
        data.ctrl[0] = -1.5 * (1.0 - np.cos(2.0 * np.pi * moment))  # N, down
        data.ctrl[1] = 0.01 * np.sin(np.pi * max(0.0, moment - 2.0))  # m, along x
        start = time.perf_counter()
        mujoco.mj_step(model, data)
        if tips is not None:
            tips.step(data)
        run.seconds[step] = time.perf_counter() - start
        run.channels[step] = data.sensor(sensor).data
        if tips is not None and tips.contact is not None:
            run.force[step] = tips.contact.force[0]
    return run


def report(alone: Run, sensed: Run, as_json: bool) -> None:
    """Print how fast physics is, alone and with the fingertip."""
    simulated = STEPS * 0.001
    figures = {
        "physics_alone": simulated / alone.seconds.sum(),
        "real_time_factor": simulated / sensed.seconds.sum(),
        "median_us": float(np.median(sensed.seconds)) * 1e6,
        "p99_us": float(np.percentile(sensed.seconds, 99)) * 1e6,
    }
    if as_json:
        print(json.dumps(figures))
        return
    print(f"physics alone: {figures['physics_alone']:.0f} times real time")
    print(f"with Taxel: {figures['real_time_factor']:.1f} times real time")
    print(f"a step: median {figures['median_us']:.0f} us, 99 % within {figures['p99_us']:.0f} us")


def draw(run: Run, path: str) -> None:
    """Draw force, pressure and electrodes over time."""
    from matplotlib.figure import Figure

    seconds = np.arange(STEPS) * 0.001
    figure = Figure(figsize=(9, 6), layout="constrained")
    force, pressure, electrodes = figure.subplots(3, 1, sharex=True)
    for axis, name in enumerate(("fx", "fy", "fz")):
        force.plot(seconds, run.force[:, axis], label=name)
    force.set_ylabel("force on the finger, N")
    force.legend(loc="upper right")
    for name in ("pdc", "pac0"):
        pressure.plot(seconds, run.channels[:, taxel.CHANNELS.index(name)], label=name)
    pressure.set_ylabel("counts")
    pressure.legend(loc="upper right")
    for name in taxel.ELECTRODES:
        values = run.channels[:, taxel.CHANNELS.index(name)]
        electrodes.plot(seconds, values - values[0], lw=0.8, label=name)
    electrodes.set_ylabel("electrodes less rest, counts")
    electrodes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), ncols=2, fontsize=6)
    electrodes.set_xlabel("time, s: pressed, from 2 s on slid, too")
    figure.savefig(path, dpi=120)


if __name__ == "__main__":
    main()
