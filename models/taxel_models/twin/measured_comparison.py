"""The twin beside real fingers: `python -m taxel_models.twin.measured_comparison LASA_FOLDER` prints both.

The LASA recordings (two BioTac fingers, pressed with their tips on a flat force sensor) have forces
and electrodes only: no position, pressure, temperature or untouched rows. So their
changes count from each electrode's median below 2 N, which is already pressed a little. The twin's changes
count from its untouched rows. Its comparable rows are those in which the indenter presses the tip's
underside close to an electrode, as a flat plate always does.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Final

import numpy as np
import typer
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from taxel.channels import ELECTRODE_COLUMNS
from taxel_models.recordings import Recording
from taxel_models.recordings.lasa import FINGERS, read_lasa_columns
from taxel_models.twin.sensor import Sensor
from taxel_models.twin.simulation import simulate
from taxel_models.twin.skin import Skin

BINS_N: Final = ((1.0, 3.0), (3.0, 4.0), (4.0, 5.0), (5.0, 6.0))
REFERENCE_N: Final = 2.0
UNTOUCHED_N: Final = 0.05
MOVED_COUNTS: Final = 100.0
RISING: Final = (1, 4, 6, 11, 14, 16)
"""The side electrodes: displaced fluid raises them."""

TIP_MM: Final = -4.0
UNDERSIDE_RAD: Final = 1.0
OVER_MM: Final = 2.0
"""The twin's comparable rows: x above `TIP_MM`, near the underside, `OVER_MM` from an electrode."""

PRESSED: Final = "most pressed, {:g} to {:g} N"
RISE: Final = "highest side electrode above 3 N, median"
MOVED: Final = "electrodes moved by over 100 above 3 N"

SOURCED: Final = {
    PRESSED.format(1, 3): "-390 to -530",
    PRESSED.format(3, 4): "-660 to -740",
    PRESSED.format(4, 5): "-990 to -1230",
    PRESSED.format(5, 6): "-1250 to -1430",
    RISE: "+110 to +240",
    MOVED: "12 to 16",
}
"""From an earlier reading of public recordings, LASA's among them."""


@dataclass(frozen=True)
class Presses:
    """One finger, row by row.

    Attributes:
        force: (n,), N.
        change: (n, 19), electrodes minus their reference, counts.
    """

    force: NDArray[np.float64]
    change: NDArray[np.float64]


def lasa(folder: Path, finger: str) -> Presses:
    """One of the LASA recordings, `F1` or `F2`."""
    forces, electrodes = read_lasa_columns(folder, finger)
    force = np.linalg.norm(forces, axis=1)
    return Presses(force, electrodes - np.median(electrodes[force < REFERENCE_N], axis=0))


def everywhere(recording: Recording) -> Presses:
    """All rows of a twin, wherever it is pressed."""
    force = np.linalg.norm(recording.samples.force, axis=1)
    electrodes = recording.channels[:, ELECTRODE_COLUMNS]
    return Presses(force, electrodes - np.median(electrodes[force < UNTOUCHED_N], axis=0))


def comparable(recording: Recording) -> Presses:
    """The rows of a twin in which it is pressed like the LASA fingers."""
    position = recording.samples.position * 1000.0
    distance = np.sqrt(Skin.of(Sensor.biotac_2p()).squared_distances(position).min(axis=1))
    around = np.abs(np.arctan2(position[:, 1], -position[:, 2]))
    keep = (position[:, 0] > TIP_MM) & (around < UNDERSIDE_RAD) & (distance < OVER_MM)
    rows = everywhere(recording)
    return Presses(rows.force[keep], rows.change[keep])


def figures(presses: Presses) -> Mapping[str, float]:
    """What is compared, by name, in counts or in electrodes."""
    found = {}
    for low, high in BINS_N:
        rows = (presses.force >= low) & (presses.force < high)
        found[PRESSED.format(low, high)] = float(np.median(presses.change[rows].min(axis=1)))
    strong = presses.change[presses.force > 3.0]
    found[RISE] = float(np.median(strong[:, np.array(RISING) - 1].max(axis=1)))
    found[MOVED] = float(np.median((np.abs(strong) > MOVED_COUNTS).sum(axis=1)))
    return found


def table(folder: Path, rows: int, seed: int) -> Table:
    """The comparison of a twin with both fingers."""
    twin = simulate(rows, seed)
    columns = [figures(everywhere(twin)), figures(comparable(twin))]
    columns += [figures(lasa(folder, finger)) for finger in FINGERS]
    lines = Table(
        "figure",
        "twin, everywhere",
        "twin, comparable rows",
        *(f"LASA {finger}" for finger in FINGERS),
        "sourced",
    )
    for name, expected in SOURCED.items():
        lines.add_row(name, *(f"{column[name]:.0f}" for column in columns), expected)
    return lines


def main(
    folder: Path,
    rows: Annotated[int, typer.Option(min=10_000, help="Of the twin; 100 are a second.")] = 300_000,
) -> None:
    """Print the twin beside the LASA recordings in FOLDER."""
    Console().print(table(folder, rows, seed=7))


if __name__ == "__main__":
    typer.run(main)
