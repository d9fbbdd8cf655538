"""The sourced constants of one BioTac 2P: the places of its electrodes and its resting counts."""

import json
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Self

import numpy as np
from numpy.typing import NDArray

from taxel.skin import Fingertip, published_geometry


@dataclass(frozen=True)
class Sensor:
    """One fingertip, untouched. Its shape is in `taxel.skin`, the other figures in `sensor.json`.

    Attributes:
        positions: (19, 3), the electrodes on the core, mm, in the sensor's frame.
        normals: (19, 3), unit vectors out of the core.
        skin_radius: radius of the cylinder along -x and of the hemisphere that closes it for x > 0, mm.
        indenter_radius: radius of the sphere that presses, mm.
        rest: counts of the untouched sensor: `pac0`, `pac1`, `pdc`, `tac`.
        electrode_rest: (19,), counts of the untouched electrodes.
    """

    positions: NDArray[np.float64]
    normals: NDArray[np.float64]
    skin_radius: float
    indenter_radius: float
    rest: dict[str, float]
    electrode_rest: NDArray[np.float64]

    @classmethod
    @cache
    def biotac_2p(cls) -> Self:
        """The sensor of the paper's data set."""
        text = (files(__package__) / "sensor.json").read_text(encoding="utf-8")
        figures = json.loads(text)
        rest = dict(figures["resting_counts"])
        shape = published_geometry()
        return cls(
            positions=np.array(
                [electrode["position_mm"] for electrode in shape["electrodes"]], dtype=float
            ),
            normals=Fingertip.biotac_2p().normals,
            skin_radius=float(shape["skin_radius_mm"]),
            indenter_radius=float(figures["indenter_radius_mm"]),
            electrode_rest=np.array(rest.pop("electrodes"), dtype=float),
            rest=rest,
        )
