"""Measures the accuracy of the calibration: `python -m taxel_models.calibration.misaligned_twin`.

A twin as long as the published recording is shifted by 5 mm and rotated by 10 degrees, both in a random
direction, but without roll, which is not identifiable. The calibration moves it back.
"""

from dataclasses import dataclass, replace
from typing import Annotated, Final

import numpy as np
import typer
from rich.console import Console
from rich.progress import track
from rich.table import Table
from scipy.spatial.transform import Rotation

from taxel.commands.cli import Json, failing_clearly, print_json
from taxel_models.calibration.calibration import Calibration, calibrate, in_sensor_frame
from taxel_models.calibration.limits import TOUCH_N
from taxel_models.calibration.motion import Motion
from taxel_models.recordings import Recording
from taxel_models.twin import simulate
from taxel_models.twin.lag import PERIOD_S
from taxel_models.twin.temperature import RECORDED_S

PAPER_ROWS: Final = round(RECORDED_S / PERIOD_S)
"""As long as the data set of Ruppel et al. 2018."""

MISALIGNED_MM: Final = 5.0
MISALIGNED_DEGREES: Final = 10.0


@dataclass(frozen=True)
class MisalignedTwin:
    """A twin, its recording by a misplaced tracker, and the calibration of that recording."""

    twin: Recording
    recorded: Recording
    found: Calibration

    @classmethod
    def calibrated(
        cls, seed: int, standoff: float | None = None, rows: int = PAPER_ROWS
    ) -> "MisalignedTwin":
        """Add an error and estimate it.

        Args:
            seed: seed of the twin and of the error.
            standoff: given to the calibration, mm; estimated if None. The twin's is 0.
            rows: of the twin; those of the paper's recording if not given.
        """
        twin = simulate(rows, seed)
        recorded = moved(twin, misalignment(seed))
        return cls(twin, recorded, calibrate([recorded], standoff=standoff))

    @property
    def off_mm(self) -> float:
        """Mean distance of positions in contact from their place before the error was added, mm."""
        true, back = self.twin.samples, in_sensor_frame(self.recorded, self.found).samples
        touched = np.linalg.norm(true.force, axis=1) > TOUCH_N
        return float(np.linalg.norm(back.position - true.position, axis=1)[touched].mean() * 1e3)


def misalignment(seed: int) -> Motion:
    """A motion of a fixed size, mm and degrees, in a random direction, without roll."""
    dice = np.random.default_rng(seed)
    angle = dice.uniform(0.0, 2.0 * np.pi)
    axis = np.array([0.0, np.cos(angle), np.sin(angle)])
    shift = dice.normal(size=3)
    return Motion(
        Rotation.from_rotvec(np.radians(MISALIGNED_DEGREES) * axis),
        MISALIGNED_MM * shift / np.linalg.norm(shift),
    )


def moved(recording: Recording, motion: Motion) -> Recording:
    """The recording as a misplaced tracker would have written it."""
    samples = recording.samples
    position = motion.apply(samples.position * 1e3) / 1e3
    return replace(recording, samples=replace(samples, position=position, force=motion.turn(samples.force)))


def main(
    seed: Annotated[int, typer.Option(min=0, help="Of the first twin; the others' follow it.")] = 60,
    twins: Annotated[int, typer.Option(min=1, help="How many.")] = 6,
    standoff: Annotated[
        float | None, typer.Option(help="Told to the calibration, mm; the twin's is 0. Else estimated.")
    ] = None,
    rows: Annotated[
        int, typer.Option(min=20_000, help="Of each twin; those of the paper's recording if not given.")
    ] = PAPER_ROWS,
    as_json: Json = False,
) -> None:
    """Print how far each twin's contacts are from their true place after calibration, mm."""
    numbers = track(
        range(seed, seed + twins), "twins", console=Console(stderr=True, quiet=as_json), transient=True
    )
    off = {number: MisalignedTwin.calibrated(number, standoff, rows).off_mm for number in numbers}
    distances = np.array(list(off.values()))
    if as_json:
        print_json({"seeds": list(off), "rows": rows, "standoff": standoff, "off_mm": distances.tolist()})
        return
    table = Table("seed", "off, mm")
    for number, distance in off.items():
        table.add_row(str(number), f"{distance:.3f}")
    table.add_section()
    table.add_row("median", f"{np.median(distances):.3f}")
    table.add_row("worst", f"{distances.max():.3f}")
    Console().print(table)


if __name__ == "__main__":
    typer.run(failing_clearly(main))
