"""The fingertips of a MuJoCo model: from its contacts to channels in its sensor data."""

from collections.abc import Sequence
from math import isfinite
from typing import Any, Final
from weakref import ReferenceType, WeakKeyDictionary, ref

import mujoco
import numpy as np
from numpy.typing import NDArray

from taxel.channels import CHANNELS
from taxel.contacts import ContactSample
from taxel.errors import InvalidArgument
from taxel.input_checks import warn
from taxel.mujoco.site_contacts import SiteContacts
from taxel.predictor import Predictor
from taxel.remote import RemotePredictor
from taxel.windows.samples import SampledSteps

# Older versions of MuJoCo have no such bit.
_SLEEP: Final = int(getattr(mujoco.mjtEnableBit, "mjENBL_SLEEP", 0))

_FALLS_ASLEEP: Final = (
    "this model lets bodies fall asleep, and MuJoCo takes their contacts away then, so that a fingertip at "
    "rest feels nothing: expected <flag sleep='disable'/>, or a fingertip that an actuator moves"
)


def add_sensor(spec: Any, site: str) -> str:
    """Add a user sensor for the channels of the fingertip whose frame is a site.

    Args:
        spec: a `mujoco.MjSpec`.
        site: the name of the site.

    Returns:
        The sensor's name: the site's, and `_taxel`.

    Raises:
        InvalidArgument: there is no such site.
    """
    if spec.site(site) is None:
        known = ", ".join(one.name for one in spec.sites if one.name) or "none"
        raise InvalidArgument(f"{site!r}: expected the name of a site of the spec; there is: {known}")
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
    """All fingertips of a model, in one simulation: the sites that have a user sensor of 21 numbers.

    Args:
        model: a `mujoco.MjModel`.
        predictor: local or remote; a remote one is never waited for.
        contacts: contact sensors to read instead of all contacts; see `SiteContacts`.
        rate_hz: how often `step` is called; after each `mj_step` if not given.
        strict: what would be warned of, such as contacts off the skin, is an error.

    Attributes:
        contact: what touches each fingertip, since the last step.
        fingers: their clocks, pasts and channels.

    Raises:
        InvalidArgument: no site has such a sensor; the rate is none; or as `SiteContacts`.
    """

    def __init__(
        self,
        model: Any,
        predictor: Predictor,
        contacts: Sequence[str] | None = None,
        *,
        rate_hz: float | None = None,
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
        rate_hz = 1.0 / model.opt.timestep if rate_hz is None else rate_hz
        self.fingers = predictor.fingers(len(users), rate_hz=rate_hz, strict=strict)
        self._sampled = SampledSteps.of(rate_hz)
        self._strict = strict
        if model.opt.enableflags & _SLEEP:
            self._tell(_FALLS_ASLEEP)
        self.contact: ContactSample | None = None
        self._time: float | None = None
        self._data: ReferenceType[Any] | None = None
        self._seen: WeakKeyDictionary[Any, float] = WeakKeyDictionary()

    def reset(self) -> None:
        """Begin again, where time does not tell: an episode of one call, or one that begins later."""
        self._begin()
        self._data = None
        self._seen.clear()

    def _begin(self) -> None:
        self.fingers.reset()
        self.contact = None
        self._time = None

    def step(self, data: Any) -> NDArray[np.float32]:
        """Take the contacts of a `mujoco.MjData` after `mj_step`, and put the newest channels into it.

        They are in `data.sensordata` until the next step, in which MuJoCo clears user sensors. If time has
        gone back since the last call, as after `mj_resetData`, or the data are others, all fingertips begin
        again.

        Returns:
            (fingertips, 21) float32, counts.

        Raises:
            InvalidArgument: the data are of another model, or these fingertips follow several in turn.
            RequestError: no prediction could be had; see `taxel.fingers.Fingers.step`.
        """
        now = data.time
        self._follow(data, now)
        elapsed = self._sampled.first_ns / 1e9 if self._time is None else now - self._time
        if elapsed > self._sampled.least_ns / 1e9:
            self._time = now
            self._sense(data, elapsed)
        channels = self.fingers.channels
        for address, values in zip(self._addresses, channels, strict=True):
            data.sensordata[address : address + len(CHANNELS)] = values
        return channels

    def _follow(self, data: Any, now: float) -> None:
        """Begin again if these are other data than last time, or if their time has gone back."""
        if not isfinite(now):
            raise InvalidArgument(
                f"data.time is {now}: expected finite seconds; the simulation has diverged"
            )
        seen = self._seen.get(data)
        is_other = self._data is None or self._data() is not data
        if seen is not None and is_other and now >= seen:
            # Each would give the other a past that it never had.
            raise InvalidArgument(
                "these fingertips have followed another MjData meanwhile: expected a `Fingertips` for each "
                "MjData, or `reset()` in between"
            )
        if is_other or (seen is not None and now < seen):
            self._begin()
        if is_other:
            self._data = ref(data)
        self._seen[data] = now

    def _tell(self, text: str) -> None:
        if self._strict:
            raise InvalidArgument(text)
        warn(text)

    def _sense(self, data: Any, elapsed: float) -> None:
        """Take the contacts as they are now, `elapsed` seconds after the last ones."""
        last = None if self.contact is None else self.contact.position
        self.contact = self._touching.read(data, last, strict=self._strict)
        self.fingers.step(self.contact.position, self.contact.force, elapsed, wait=self._wait)

    def close(self) -> None:
        """End the thread that asks a remote predictor."""
        self.fingers.close()
