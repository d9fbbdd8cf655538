"""The constants of a simulated finger and its rig that differ from one to another."""

from dataclasses import dataclass, field
from typing import Final

from taxel_models.twin.fluid import POCKET_SPREAD
from taxel_models.twin.pressure import CARRIED_SPREAD
from taxel_models.twin.sensor import Sensor
from taxel_models.twin.temperature import COOLING_K

TRACKING_MM: Final = 0.556
"""SD of a contact's tracking error in each axis. The mean distance of light touches from the skin is then
0.444 mm, as in the paper's data set after calibration."""

JITTER_MM: Final = 0.05
FORCE_NOISE_N: Final = 0.01
"""SDs of one position and of one force. Assumptions."""

FLUID_LAG_S: Final = 0.02
"""The fluid flows out from under the indenter within 2 to 3 rows (LASA recordings)."""


@dataclass(frozen=True)
class Constants:
    """A finger and its rig; the defaults are those of the paper's data set.

    Attributes:
        sensor: geometry and resting counts.
        tracking_mm: SD of a contact's tracking error in each axis.
        force_noise_n: SD of one force.
        fluid_lag_s: time constant of the fluid's flow.
        pocket_spread: SD, over contacts, of the share of fluid that stays under the indenter.
        carried_spread: SD, over contacts, of the share of the load that the fluid carries.
        on_for_s: how long the finger is switched on before the first row.
        cooling_k: how far a long contact cools the core.
    """

    sensor: Sensor = field(default_factory=Sensor.biotac_2p)
    tracking_mm: float = TRACKING_MM
    force_noise_n: float = FORCE_NOISE_N
    fluid_lag_s: float = FLUID_LAG_S
    pocket_spread: float = POCKET_SPREAD
    carried_spread: float = CARRIED_SPREAD
    on_for_s: float = 0.0
    cooling_k: float = COOLING_K
