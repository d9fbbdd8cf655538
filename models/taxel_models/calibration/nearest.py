"""The electrode nearest to each contact: it shows how evenly a recording covers the sensor."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from taxel.channels import ELECTRODES
from taxel.skin import height_above_skin
from taxel_models.twin.sensor import Sensor

NEAR_MM: Final = 2.0
"""Contacts further from the skin are not counted (the paper)."""


@dataclass(frozen=True)
class NearestElectrodes:
    """Contacts by electrode.

    Attributes:
        contacts: (19,), number of contacts that are nearest to each electrode.
        off_skin: contacts that were not counted.
    """

    contacts: NDArray[np.int64]
    off_skin: int

    @classmethod
    def of(cls, points: NDArray[np.float64], sensor: Sensor) -> "NearestElectrodes":
        """Count points (n, 3), mm, in the sensor's frame."""
        near = points[np.abs(height_above_skin(points, sensor.skin_radius)) < NEAR_MM]
        distances = np.linalg.norm(near[:, None] - sensor.positions[None], axis=2)
        counts = np.bincount(distances.argmin(axis=1), minlength=len(ELECTRODES))
        return cls(counts, len(points) - len(near))

    def report(self) -> dict[str, object]:
        """For JSON."""
        return {
            "contacts": dict(zip(ELECTRODES, self.contacts.tolist(), strict=True)),
            "counted": int(self.contacts.sum()),
            "off_skin": self.off_skin,
        }
