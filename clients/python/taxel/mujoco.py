"""BioTac fingertips in MuJoCo: 21 channels in `data.sensordata`, without a plugin.

    spec = mujoco.MjSpec.from_file("hand.xml")
    taxel.mujoco.add_sensor(spec, site="biotac")
    model = spec.compile()
    data = mujoco.MjData(model)
    tips = taxel.mujoco.Fingertips(model, predictor)
    while True:
        mujoco.mj_step(model, data)
        tips.step(data)  # data.sensor("biotac_taxel").data has the channels

The site is the sensor's frame (`taxel.skin`): x to the tip, z out of the nail. Needs MuJoCo 3.
"""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from taxel.channels import CHANNELS
from taxel.contacts import ContactSample, fingertip_contacts
from taxel.errors import InvalidArgument, MissingDependency
from taxel.predictor import Predictor
from taxel.remote import RemotePredictor
from taxel.windows.combinations import PERIOD_NS

try:
    import mujoco
except ModuleNotFoundError as error:
    raise MissingDependency("taxel.mujoco", str(error.name), "mujoco") from None

_TICK_S: Final = PERIOD_NS / 1e9
_NETFORCE: Final = 14
"""Numbers of a contact sensor with the fields found, force, torque, dist, pos, normal."""

_REDUCED: Final = [63, 3, 1]
"""`sensor_intprm` of such a sensor: a bit for each of these fields, `reduce="netforce"`, `num="1"`."""


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


class SiteContacts:
    """Reads what touches fingertips whose frames are sites, as `taxel.contacts` makes it from contacts.

    Args:
        model: a `mujoco.MjModel`.
        sites: names of the sites, or their numbers.
        contacts: for each fingertip, the name of a contact sensor with `num="1"`, `reduce="netforce"` and
            `data="found force torque dist pos normal"` whose first or second object is the fingertip: a
            geom, its body, or a subtree with it. If not given, all contacts of the geoms of the site's body
            count; only then are contacts that are far apart told from each other.

    Attributes:
        sites: (n,) the numbers of the sites.

    Raises:
        InvalidArgument: there is no such site; a contact sensor is none, or not of the fingertip; or
            without contact sensors, nothing of a site's body can touch, or two sites are on one body.
    """

    def __init__(
        self, model: Any, sites: Sequence[str] | NDArray[np.int64], contacts: Sequence[str] | None = None
    ) -> None:
        self._model = model
        self.sites = np.array([_site(model, site) for site in sites], np.int64)
        bodies = model.site_bodyid[self.sites].tolist()
        if contacts is None:
            self._nets = None
            self._check_bodies(bodies)
        elif len(contacts) != len(bodies):
            raise InvalidArgument(
                f"{len(contacts)} contact sensors: expected one for each of {len(bodies)} fingertips"
            )
        else:
            self._nets = [self._net(name, body) for name, body in zip(contacts, bodies, strict=True)]
        # The fingertip of each geom, or -1; the last one stands for what has no geom, of number -1.
        numbers = {body: number for number, body in enumerate(bodies)}
        owners = [numbers.get(int(body), -1) for body in model.geom_bodyid]
        self._finger_of = np.array([*owners, -1], np.int64)

    def read(
        self, data: Any, last: NDArray[np.float64] | None = None, strict: bool = False
    ) -> ContactSample:
        """The contacts of a `mujoco.MjData` after `mj_step` or `mj_forward`.

        Args:
            data: of the model.
            last: (n, 3), the places of the last step, m, for fingertips that nothing touches.
            strict: contacts off the skin are an error, not a warning.
        """
        points, forces, on = self._contacts(data) if self._nets is None else self._net_contacts(data)
        rotations = data.site_xmat[self.sites].reshape(-1, 3, 3)
        return fingertip_contacts(
            points, forces, data.site_xpos[self.sites], rotations, finger=on, last=last, strict=strict
        )

    def _contacts(self, data: Any) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]:
        """Points, forces on the finger, and fingertips of all contacts; world frame."""
        fingers = self._finger_of[np.asarray(data.contact.geom).reshape(-1, 2)]
        numbers, places = np.nonzero(fingers >= 0)
        wrench, forces = np.zeros(6), np.empty((len(numbers), 3))
        for row, number in enumerate(numbers.tolist()):
            mujoco.mj_contactForce(self._model, data, number, wrench)
            forces[row] = wrench[:3]
        # Rows of the frame are the contact's axes. MuJoCo tells the force on the second geom.
        frames = np.asarray(data.contact.frame).reshape(-1, 3, 3)[numbers]
        forces = np.einsum("kij,ki->kj", frames, forces) * np.where(places, 1.0, -1.0)[:, None]
        points = np.asarray(data.contact.pos).reshape(-1, 3)[numbers]
        return points, forces, fingers[numbers, places]

    def _check_bodies(self, bodies: Sequence[int]) -> None:
        """Refuse bodies whose contacts would never be told."""
        model = self._model
        touching = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
        touching[model.pair_geom1] = touching[model.pair_geom2] = True
        for number, body in enumerate(bodies):
            name = model.site(self.sites[number]).name
            if body in bodies[:number]:
                raise InvalidArgument(
                    f"site {name!r} is on the body of another fingertip: expected a body for each, or "
                    "contact sensors"
                )
            if not touching[model.geom_bodyid == body].any():
                raise InvalidArgument(
                    f"site {name!r} is on a body without a geom that can touch: expected the site on the "
                    "body of the fingertip's geoms, or a contact sensor"
                )

    def _net(self, name: str, body: int) -> tuple[int, float]:
        """The address of a contact sensor, and the sign of its force as one on this body."""
        model = self._model
        number = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SENSOR, name)
        if (
            number < 0
            or model.sensor_dim[number] != _NETFORCE
            or model.sensor_type[number] != mujoco.mjtSensor.mjSENS_CONTACT
            or model.sensor_intprm[number][:3].tolist() != _REDUCED
        ):
            raise InvalidArgument(
                f"{name!r}: expected a contact sensor with num='1', reduce='netforce' and "
                "data='found force torque dist pos normal'"
            )
        # The sensor tells what its first object does to the second.
        address = int(model.sensor_adr[number])
        if self._has(model.sensor_objtype[number], model.sensor_objid[number], body):
            return address, -1.0
        if self._has(model.sensor_reftype[number], model.sensor_refid[number], body):
            return address, 1.0
        raise InvalidArgument(
            f"{name!r}: neither object of this contact sensor is a fingertip: expected a geom of "
            f"{model.body(body).name!r}, this body, or a subtree with it"
        )

    def _has(self, kind: int, number: int, body: int) -> bool:
        """Whether an object of a contact sensor moves as one with a body, or is a subtree with it."""
        model = self._model
        if kind == mujoco.mjtObj.mjOBJ_XBODY:
            while body not in (number, 0):
                body = int(model.body_parentid[body])
            return body == number
        if kind == mujoco.mjtObj.mjOBJ_GEOM:
            number = int(model.geom_bodyid[number])
        elif kind != mujoco.mjtObj.mjOBJ_BODY:
            return False
        return self._carrier(number) == self._carrier(body)

    def _carrier(self, body: int) -> int:
        """The topmost body below the world that this one is fixed to."""
        parents, joints = self._model.body_parentid, self._model.body_jntnum
        while not joints[body] and parents[body]:
            body = int(parents[body])
        return body

    def _net_contacts(
        self, data: Any
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]:
        nets = self._nets or ()
        rows = np.array([data.sensordata[address : address + _NETFORCE] for address, _ in nets])
        signs = np.array([sign for _, sign in nets])
        on = np.flatnonzero(rows[:, 0] > 0)
        return rows[on, 8:11], rows[on, 1:4] * signs[on, None], on


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


def _site(model: Any, site: str | np.int64) -> int:
    """The number of a site."""
    if not isinstance(site, str):
        return int(site)
    number = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, site)
    if number < 0:
        raise InvalidArgument(f"{site!r}: expected the name of a site of the MuJoCo model")
    return int(number)
