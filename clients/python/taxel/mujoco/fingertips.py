"""The fingertips of a MuJoCo model: from its contacts to channels in its sensor data."""

from collections.abc import Sequence
from typing import Any, Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from taxel.channels import CHANNELS
from taxel.contacts import ContactSample
from taxel.errors import InvalidArgument
from taxel.mujoco.site_contacts import SiteContacts
from taxel.predictor import Predictor
from taxel.remote import RemotePredictor
from taxel.windows.combinations import PERIOD_NS

_TICK_S: Final = PERIOD_NS / 1e9


def add_sensor(spec: Any, site: str) -> str:
    """Add a user sensor for the channels of the fingertip whose frame is a site.

    Args:
        spec: a `mujoco.MjSpec`.
        site: the name of the site.

    Returns:
        The sensor's name: the site's, and `_taxel`.
    """
    name = f"{site}_taxel"
    spec.add_sensor(
        name=name,
        type=mujoco.mjtSensor.mjSENS_USER,
        objtype=mujoco.mjtObj.mjOBJ_SITE,
        objname=site,
        dim=len(CHANNELS),
        needstage=mujoco.mjtStage.mjSTAGE_ACC,
        datatype=mujoco.mjtDataType.mjDATATYPE_REAL,
    )
    return name


class Fingertips:
    """All fingertips of a model: the sites that have a user sensor of 21 numbers.

    Args:
        model: a `mujoco.MjModel`.
        predictor: local or remote; a remote one is never waited for.
        contacts: contact sensors to read instead of all contacts; see `SiteContacts`.
        strict: what would be warned of, such as contacts off the skin, is an error.

    Attributes:
        contact: what touches each fingertip, since the last step.
        fingers: their clocks, pasts and channels.

    Raises:
        InvalidArgument: no site has such a sensor; or as `SiteContacts`.
    """

    def __init__(
        self,
        model: Any,
        predictor: Predictor,
        contacts: Sequence[str] | None = None,
        *,
        strict: bool = False,
    ) -> None:
        users = np.flatnonzero(
            (model.sensor_type == mujoco.mjtSensor.mjSENS_USER)
            & (model.sensor_objtype == mujoco.mjtObj.mjOBJ_SITE)
            & (model.sensor_dim == len(CHANNELS))
        )
        if not len(users):
            raise InvalidArgument(
                "the MuJoCo model has no user sensor of 21 numbers on a site: add one with "
                "taxel.mujoco.add_sensor, or in XML: "
                "<user objtype='site' objname='biotac' dim='21' needstage='acc'/>"
            )
        self._touching = SiteContacts(model, model.sensor_objid[users], contacts)
        self._addresses = model.sensor_adr[users]
        self._wait = not isinstance(predictor, RemotePredictor)
        # Where ticks fall on steps, the steps between them change no window, and are left out.
        steps = round(_TICK_S / model.opt.timestep)
        on_steps = steps > 1 and abs(steps * model.opt.timestep - _TICK_S) < 1e-9
        self._least_s = _TICK_S - 0.5 * model.opt.timestep if on_steps else 0.0
        rate_hz = 1.0 / _TICK_S if on_steps else 1.0 / model.opt.timestep
        self.fingers = predictor.fingers(len(users), rate_hz=rate_hz, strict=strict)
        self._strict = strict
        self.contact: ContactSample | None = None
        self._time: float | None = None
        self._seen = -np.inf

    def reset(self) -> None:
        """Begin again, where time does not tell: an episode of one call, or one that begins later."""
        self.fingers.reset()
        self.contact = None
        self._time = None
        self._seen = -np.inf

    def step(self, data: Any) -> NDArray[np.float32]:
        """Take the contacts of a `mujoco.MjData` after `mj_step`, and put the newest channels into it.

        They are in `data.sensordata` until the next step, in which MuJoCo clears user sensors. If time has
        gone back since the last call, as after `mj_resetData`, all fingertips begin again.

        Returns:
            (fingertips, 21) float32, counts.

        Raises:
            RequestError: no prediction could be had; see `taxel.fingers.Fingers.step`.
        """
        now = data.time
        if now < self._seen:
            self.reset()
        self._seen = now
        elapsed = None if self._time is None else now - self._time
        if elapsed is None or elapsed > self._least_s:
            self._time = now
            self._sense(data, elapsed)
        channels = self.fingers.channels
        for address, values in zip(self._addresses, channels, strict=True):
            data.sensordata[address : address + len(CHANNELS)] = values
        return channels

    def _sense(self, data: Any, elapsed: float | None) -> None:
        """Take the contacts as they are now, `elapsed` seconds after the last ones."""
        last = None if self.contact is None else self.contact.position
        self.contact = self._touching.read(data, last, strict=self._strict)
        self.fingers.step(self.contact.position, self.contact.force, elapsed, wait=self._wait)

    def close(self) -> None:
        """End the thread that asks a remote predictor."""
        self.fingers.close()
