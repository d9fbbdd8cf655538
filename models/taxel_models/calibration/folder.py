"""A calibration on disk.

DIR/calibration.json    distances, transforms, intervals, nearest electrodes
DIR/contacts.png        the light contacts on the skin, before and after
DIR/electrodes.png      contacts by nearest electrode
DIR/recordings/*.csv    on request, the recordings in the sensor's frame
"""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from taxel.atomic import whole_folder
from taxel_models.calibration.calibration import Calibration, in_sensor_frame
from taxel_models.calibration.contact_plots import draw_contacts, draw_nearest
from taxel_models.recordings import Recording, write_ruppel
from taxel_models.twin.sensor import Sensor

RECORD: Final = "calibration.json"


def write_calibration(
    calibration: Calibration, folder: Path, rewritten: Sequence[Recording] = (), *, overwrite: bool = False
) -> None:
    """Write a calibration; the folder appears whole or not at all.

    Args:
        rewritten: recordings to write in the sensor's frame.

    Raises:
        SettingsError: the folder exists and may not be overwritten, or is not a calibration.
    """
    with whole_folder(folder, replacing=RECORD, overwrite=overwrite) as place:
        text = json.dumps(calibration.report(), indent=1, allow_nan=False) + "\n"
        (place / RECORD).write_text(text, encoding="utf-8")
        draw_contacts(calibration, Sensor.biotac_2p(), place / "contacts.png")
        draw_nearest(calibration, place / "electrodes.png")
        if rewritten:
            (place / "recordings").mkdir()
        for number, recording in enumerate(rewritten, start=1):
            path = place / "recordings" / f"{number}_{Path(recording.name).stem}.csv"
            write_ruppel(in_sensor_frame(recording, calibration), path)
