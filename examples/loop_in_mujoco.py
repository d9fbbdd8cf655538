"""The loop, closed in a simulator: a fingertip in MuJoCo feels what its model lacks.

    pip install 'taxel[loop,mujoco]'
    python examples/loop_in_mujoco.py
    python examples/loop_in_mujoco.py --json

A fingertip presses a table in MuJoCo. Its real sensor is played by the same model with an effect that the
model does not declare, creep: channels relax after each change of load. What it measures is recorded.
`taxel loop` compares the recording with the model, names what is missing, and adds a corrected version to
the repository. The running server loads that version (SIGHUP). In new presses, the simulated channels are
compared with the real ones, before and after.
"""

import argparse
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

import taxel
import taxel.mujoco
from taxel.local import shipped_repository
from taxel_bench.server_process import running_server_process
from taxel_models.recordings.recording import Recording
from taxel_models.recordings.ruppel import write_ruppel

Array = NDArray[np.float64]

SCENE = """
<mujoco>
  <option timestep="0.002" gravity="0 0 0"/>
  <worldbody>
    <geom type="box" size="0.1 0.1 0.01" pos="0 0 -0.01" friction="0.8"/>
    <body pos="0 0 0.02">
      <joint name="press" type="slide" axis="0 0 1" damping="5" range="-0.03 0.005" limited="true"/>
      <joint name="pitch" type="hinge" axis="0 1 0" damping="0.02"/>
      <joint name="roll" type="hinge" axis="1 0 0" damping="0.02"/>
      <geom type="capsule" fromto="-0.017 0 0 0 0 0" size="0.007" mass="0.05" friction="0.8"/>
      <site name="biotac"/>
    </body>
  </worldbody>
  <actuator>
    <motor joint="press"/>
    <position joint="pitch" kp="4"/>
    <position joint="roll" kp="4"/>
  </actuator>
</mujoco>
"""
TICK_S = 0.01
PRESS_S = 2.0
CREEP_S = 0.6
NOISE = 4.0
"""Standard deviation of the real sensor's noise, counts."""
SHOWN_S = 10.0


def main() -> None:
    """Record, run the loop, and compare before and after."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--model", default="xgb")
    parser.add_argument("--seconds", type=float, default=200.0, help="of the recording")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        found = close_the_loop(Path(folder), options)
    if options.json:
        print(json.dumps(found))


def close_the_loop(folder: Path, options: argparse.Namespace) -> dict[str, Any]:
    """Everything, in a folder that may be thrown away; the figures."""

    def tell(text: str) -> None:
        if not options.json:
            print(text, flush=True)

    repository = folder / "repository"
    shutil.copytree(shipped_repository() / options.model, repository / options.model)
    with taxel.load(repository) as source:
        lacking = source.predictor(options.model)
        recorded = real_sensor(lacking, presses(options.seconds, options.seed), options.seed)
        fresh = real_sensor(lacking, presses(3 * SHOWN_S, options.seed + 1), options.seed + 1)
    write_ruppel(recorded, folder / "real.csv")
    with running_server_process(repository) as server, taxel.connect(server.endpoint) as source:
        before = follow(source.predictor(options.model), fresh, tell)
        tell("taxel loop: what does the model lack?")
        report = loop(folder, options.model)
        named = [effect["name"] for effect in report["effects"]]
        tell(f"named: {', '.join(named) or 'nothing'}")
        os.kill(server.pid, signal.SIGHUP)
        predictor = newest(source, options.model, "2")
        after = follow(predictor, fresh, tell)
    return {"effects": named, "error_before": before, "error_after": after, "noise": NOISE}


def presses(seconds: float, seed: int) -> tuple[Array, Array]:
    """Places, m, and forces, N, at each tick: presses of random force, each with another side."""
    random = np.random.default_rng(seed)
    model = mujoco.MjModel.from_xml_string(SCENE)
    data = mujoco.MjData(model)
    touching = taxel.mujoco.SiteContacts(model, ["biotac"])
    every = round(TICK_S / model.opt.timestep)
    positions, forces = [], []
    last, peak, hold = None, 0.0, 0.0
    for step in range(round(seconds / model.opt.timestep)):
        phase = data.time % PRESS_S
        if phase < model.opt.timestep:
            peak, hold = random.uniform(1.0, 6.0), random.uniform(0.3, 1.0)
            data.ctrl[1:] = random.uniform([0.1, -0.9], [1.3, 0.9])
        # Up and turned first; then pressed within 0.2 s, held, and let go.
        data.ctrl[0] = np.interp(phase, [0.5, 0.7, 0.7 + hold, 0.9 + hold], [0.5, -peak, -peak, 0.5])
        mujoco.mj_step(model, data)
        if step % every == every - 1:
            sample = touching.read(data, last)
            last = sample.position
            positions.append(sample.position[0])
            forces.append(sample.force[0])
    return np.array(positions), np.array(forces)


def real_sensor(model: taxel.Predictor, contacts: tuple[Array, Array], seed: int) -> Recording:
    """What the real sensor measures: the model's channels, creep, and noise."""
    position, force = contacts
    random = np.random.default_rng(seed)
    ticks = np.arange(len(force), dtype=np.int64) * round(TICK_S * 1e9)
    windows = taxel.build_windows(taxel.Samples.of(ticks, position, force), model.window)
    counts = model.predict(windows.values).astype(np.float64)
    # The same for every seed: it is one sensor.
    weights = np.random.default_rng(0).normal(0.0, 15.0, len(taxel.CHANNELS))
    kept = 1.0 - np.exp(-TICK_S / CREEP_S)
    crept, level = np.zeros(len(force)), 0.0
    for row, pushed in enumerate(np.linalg.norm(force, axis=1)):
        level += kept * (pushed - level)
        crept[row] = level - pushed
    rows = windows.rows
    counts += crept[rows, None] * weights + random.normal(0.0, NOISE, counts.shape)
    channels = np.clip(np.rint(counts), 0, taxel.COUNTS_MAX)
    still = np.full(len(rows), 2000.0)
    auxiliary = {"pac1": channels[:, 0], "tac": still, "tdc": still}
    return Recording.of(ticks[rows], position[rows], force[rows], channels, auxiliary)


def follow(predictor: taxel.Predictor, real: Recording, tell: Any) -> float:
    """Feel the same contacts in the simulator, tick by tick; the mean distance from real, counts."""
    fingers = predictor.fingers(1)
    late = round(fingers.delay_s / TICK_S)
    errors: list[float] = []
    label = f"{predictor.manifest.name}/{predictor.manifest.version}"
    shown = round(SHOWN_S / TICK_S)
    for tick in range(len(real.samples)):
        channels = fingers.step(real.samples.position[tick : tick + 1], real.samples.force[tick : tick + 1])
        if tick >= late:
            errors.append(float(np.abs(channels[0] - real.channels[tick - late]).mean()))
        if len(errors) and not (tick + 1) % shown:
            tell(f"{label} after {(tick + 1) * TICK_S:.0f} s: {np.mean(errors[-shown:]):.1f} counts off")
    return float(np.mean(errors))


def loop(folder: Path, model: str) -> dict[str, Any]:
    """Run `taxel loop`, which adds version 2 to the repository; its report."""
    command = [sys.executable, "-m", "taxel", "loop", "--model", model, "--export"]
    command += ["--repository", str(folder / "repository"), "--data", str(folder / "real.csv")]
    subprocess.run([*command, "-o", str(folder / "report")], check=True, stdout=subprocess.DEVNULL)
    report: dict[str, Any] = json.loads((folder / "report" / "report.json").read_text(encoding="utf-8"))
    return report


def newest(source: taxel.PredictorSource, model: str, version: str) -> taxel.Predictor:
    """The predictor of a version, as soon as the server has loaded it."""
    until = time.monotonic() + 60.0
    while not any(
        (each.name, each.version, each.state) == (model, version, "READY") for each in source.models()
    ):
        if time.monotonic() > until:
            raise SystemExit(f"the server did not load {model}/{version} within a minute")
        time.sleep(0.1)
    return source.predictor(model, version)


if __name__ == "__main__":
    main()
