"""What touches fingertips whose frames are sites of a MuJoCo model."""

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from taxel.contacts import ContactSample, fingertip_contacts
from taxel.errors import InvalidArgument
from taxel.mujoco.contact_sensor import ContactSensor


class SiteContacts:
    """Reads what touches fingertips whose frames are sites, as `taxel.contacts` makes it from contacts.

    Args:
        model: a `mujoco.MjModel`.
        sites: names of the sites, or their numbers.
        contacts: for each fingertip, the name of a contact sensor with `num="1"`, `reduce="netforce"` and
            `data="found force torque dist pos normal"` whose first or second object is the fingertip: a
            geom, its body, or this body's subtree. If not given, all contacts count of the geoms of the
            site's body, and of bodies that are fixed to it below it; only then are contacts that are far
            apart told from each other.

    Attributes:
        sites: (n,) the numbers of the sites.

    Raises:
        InvalidArgument: there is no such site, or one comes twice; a contact sensor is none, or not of the
            fingertip; or without contact sensors, nothing of a site's body can touch, or two sites are on
            one body.
    """

    def __init__(
        self, model: Any, sites: Sequence[str] | NDArray[np.int64], contacts: Sequence[str] | None = None
    ) -> None:
        self._model = self._like = model
        for what, given in (("sites", sites), ("contacts", contacts)):
            if isinstance(given, str):
                raise InvalidArgument(f"{what} is {given!r}: expected a list of names")
        self.sites = np.array([_site(model, site) for site in sites], np.int64)
        again = [site for number, site in enumerate(self.sites) if site in self.sites[:number]]
        if again:
            raise InvalidArgument(
                f"site {model.site(again[0]).name!r} comes twice: expected a site for each"
            )
        bodies = model.site_bodyid[self.sites].tolist()
        # The fingertip of each geom, or -1; the last one stands for what has no geom, of number -1.
        self._finger_of = np.append(_fingers_of_bodies(model, bodies)[model.geom_bodyid], -1)
        if contacts is None:
            self._nets = None
            self._check_bodies(bodies)
        elif len(contacts) != len(bodies):
            raise InvalidArgument(
                f"{len(contacts)} contact sensors: expected one for each of {len(bodies)} fingertips"
            )
        else:
            self._nets = [
                ContactSensor.of(model, name, body) for name, body in zip(contacts, bodies, strict=True)
            ]

    def read(
        self, data: Any, last: NDArray[np.float64] | None = None, strict: bool = False
    ) -> ContactSample:
        """The contacts of a `mujoco.MjData` after `mj_step` or `mj_forward`.

        Args:
            data: of the model.
            last: (n, 3), the places of the last step, m, for fingertips that nothing touches.
            strict: contacts off the skin are an error, not a warning.

        Raises:
            InvalidArgument: the data are of another model, or were never stepped; or, if strict, contacts
                are off the skin.
        """
        if data.model is not self._like:
            self._check_model(data.model)
        points, forces, on = self._contacts(data) if self._nets is None else self._net_contacts(data)
        rotations = data.site_xmat[self.sites].reshape(-1, 3, 3)
        if not rotations.any():
            raise InvalidArgument(
                "the data have no poses yet: expected `mj_step` or `mj_forward` after they were made or "
                "reset"
            )
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

    def _check_model(self, model: Any) -> None:
        """Refuse data of a model whose geoms, sites or sensors have other numbers."""
        numbers = ("geom_bodyid", "site_bodyid", "sensor_adr", "sensor_type", "body_parentid")
        if not all(np.array_equal(getattr(model, one), getattr(self._model, one)) for one in numbers):
            raise InvalidArgument(
                "the data are of another model, as after `spec.recompile`: expected data of the model that "
                "this was made for"
            )
        self._like = model

    def _check_bodies(self, bodies: Sequence[int]) -> None:
        """Refuse bodies whose contacts would never be told."""
        model = self._model
        touching = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
        touching[model.pair_geom1] = touching[model.pair_geom2] = True
        names = [model.site(site).name for site in self.sites]
        for number, body in enumerate(bodies):
            if body in bodies[:number]:
                raise InvalidArgument(
                    f"site {names[number]!r} is on the body of another fingertip: expected a body for "
                    "each, or contact sensors"
                )
        for number, name in enumerate(names):
            if not touching[self._finger_of[:-1] == number].any():
                raise InvalidArgument(
                    f"site {name!r} is on a body without a geom that can touch, and so is what is fixed to "
                    "it: expected the site on the body of the fingertip's geoms, or a contact sensor"
                )

    def _net_contacts(
        self, data: Any
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]:
        nets = self._nets or ()
        rows = np.array([net.read(data) for net in nets])
        on = np.flatnonzero(rows[:, 0] > 0)
        return rows[on, 8:11], rows[on, 1:4] * np.array([net.sign for net in nets])[on, None], on


def _fingers_of_bodies(model: Any, bodies: Sequence[int]) -> NDArray[np.int64]:
    """(bodies,) the fingertip that each body of a model belongs to, or -1.

    Args:
        bodies: those of the fingertips. What is fixed to one below it, without a joint, is part of it.
    """
    numbers = {body: number for number, body in enumerate(bodies)}
    fingers = np.full(model.nbody, -1, np.int64)
    # A parent has a lower number than its children.
    for body, (parent, joints) in enumerate(zip(model.body_parentid, model.body_jntnum, strict=True)):
        # The world's children are no part of what stands on it.
        fingers[body] = numbers.get(body, fingers[parent] if parent and not joints else -1)
    return fingers


def _site(model: Any, site: str | np.int64) -> int:
    """The number of a site."""
    if not isinstance(site, str):
        if not 0 <= site < model.nsite:
            raise InvalidArgument(f"site {site}: expected a number below {model.nsite}, or a name")
        return int(site)
    number = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, site)
    if number < 0:
        raise InvalidArgument(f"{site!r}: expected the name of a site of the MuJoCo model")
    return int(number)
