"""`taxel calibrate`: find the sensor's frame from light contacts."""

from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Table

from taxel.commands.cli import OUT, Json, needs, print_json
from taxel.commands.progress import shown
from taxel_models.calibration.limits import LIGHT_N, TOUCH_N, Limits

_DISTANCES = ("mean", "median", "rms")


@needs("loop", "matplotlib", "scipy")
def calibrate(
    recordings: Annotated[
        list[Path],
        typer.Argument(metavar="RECORDING…", help="Recordings in one frame: CSV files or folders."),
    ],
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder to write the calibration to.")],
    rewrite: Annotated[
        bool, typer.Option("--rewrite", help="Also write the recordings in the sensor's frame, as CSV.")
    ] = False,
    standoff: Annotated[
        float | None,
        typer.Option(
            metavar="MM", help="Distance of the tracked point from the skin at first touch, if known."
        ),
    ] = None,
    light: Annotated[
        float, typer.Option(metavar="N", help="A contact is light below this force.")
    ] = LIGHT_N,
    touch: Annotated[
        float, typer.Option(metavar="N", help="Below this force there is no contact.")
    ] = TOUCH_N,
    seed: Annotated[
        int, typer.Option(min=0, help="Seed of the optimiser's starts and of the bootstrap.")
    ] = 0,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace an earlier calibration.")] = False,
    as_json: Json = False,
) -> None:
    """Find the sensor's frame from light contacts: they must lie on its skin.

    `--json` prints what `calibration.json` holds, and the folder.
    """
    from taxel.atomic import check_folder_place
    from taxel_models.calibration.calibration import calibrate as estimate
    from taxel_models.calibration.folder import RECORD, write_calibration
    from taxel_models.recordings.reading import read_unchecked

    output = output.resolve()
    check_folder_place(output, replacing=RECORD, overwrite=overwrite)
    limits = Limits(touch, light)
    with shown("reading") as tell:
        read = [read_unchecked(path) for path in recordings]
        tell("fitting")
        calibration = estimate(read, limits=limits, standoff=standoff, seed=seed)
        tell("writing")
        write_calibration(calibration, output, read if rewrite else (), overwrite=overwrite)
    report = calibration.report()
    if as_json:
        print_json({"output": str(output), **report})
        return
    _print(report)
    OUT.print(f"Wrote {output}.", soft_wrap=True)


def _print(report: dict[str, Any]) -> None:
    table = Table(f"distance of {report['light_contacts']} light contacts from the skin, mm", *_DISTANCES)
    for label, values in report["distance_mm"].items():
        table.add_row(label, *(f"{values[name]:.3f}" for name in _DISTANCES))
    OUT.print(table)
    sensor = report["sensor"]
    OUT.print(f"translation, mm: {_numbers(sensor['translation_mm'], 3)}")
    quaternion = _numbers(sensor["quaternion_xyzw"], 5)
    OUT.print(f"rotation: {sensor['rotation_deg']:.3f}°, quaternion x y z w: {quaternion}")
    table = Table("component", "value", "standard error", "95 % interval", "unit")
    for name, part in report["components"].items():
        if "value" not in part:
            table.add_row(name, part["status"], "", "", part["unit"])
        elif "standard_error" not in part:
            table.add_row(name, f"{part['value']:.3f}", part["status"], "", part["unit"])
        else:
            low, high = part["interval_95"]
            table.add_row(
                name,
                f"{part['value']:.3f}",
                f"{part['standard_error']:.3f}",
                f"{low:.3f} to {high:.3f}",
                part["unit"],
            )
    OUT.print(table)
    for name, reason in report["not_identifiable"].items():
        OUT.print(f"{name} is not identifiable: {reason}.", soft_wrap=True)


def _numbers(values: list[float], digits: int) -> str:
    return ", ".join(f"{value:.{digits}f}" for value in values)
