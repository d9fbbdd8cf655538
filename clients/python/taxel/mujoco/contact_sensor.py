"""Contact sensors of MuJoCo that tell all of a fingertip's contacts as one."""

from typing import Any, Final, NamedTuple, Self

import mujoco
import numpy as np
from numpy.typing import NDArray

from taxel.errors import InvalidArgument

_NETFORCE: Final = 14
"""Numbers of a contact sensor with the fields found, force, torque, dist, pos, normal."""

_REDUCED: Final = [63, 3, 1]
"""`sensor_intprm` of such a sensor: a bit for each of these fields, `reduce="netforce"`, `num="1"`."""


class ContactSensor(NamedTuple):
    """A contact sensor of one fingertip.

    Attributes:
        address: of its numbers in `sensordata`.
        sign: of its force as one on the fingertip.
    """

    address: int
    sign: float

    def read(self, data: Any) -> NDArray[np.float64]:
        """Its numbers."""
        return np.asarray(data.sensordata[self.address : self.address + _NETFORCE])

    @classmethod
    def of(cls, model: Any, name: str, body: int) -> Self:
        """A contact sensor of the fingertip on this body.

        Raises:
            InvalidArgument: there is none of this name and kind, or it is not of the fingertip.
        """
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
        if model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_SENSOR:
            raise InvalidArgument(f"{name!r}: the model has its sensors disabled: expected them enabled")
        # The sensor tells what its first object does to the second.
        address = int(model.sensor_adr[number])
        if _is_on(model, model.sensor_objtype[number], model.sensor_objid[number], body):
            return cls(address, -1.0)
        if _is_on(model, model.sensor_reftype[number], model.sensor_refid[number], body):
            return cls(address, 1.0)
        raise InvalidArgument(
            f"{name!r}: neither object of this contact sensor is a fingertip: expected a geom of "
            f"{model.body(body).name!r}, this body, or its subtree"
        )


def _is_on(model: Any, kind: int, number: int, body: int) -> bool:
    """Whether an object of a contact sensor moves as one with a body, as the root of a subtree may."""
    if kind == mujoco.mjtObj.mjOBJ_GEOM:
        number = int(model.geom_bodyid[number])
    elif not (kind == mujoco.mjtObj.mjOBJ_BODY or kind == mujoco.mjtObj.mjOBJ_XBODY):
        return False
    return _carrier(model, number) == _carrier(model, body)


def _carrier(model: Any, body: int) -> int:
    """The topmost body below the world that this one is fixed to."""
    parents, joints = model.body_parentid, model.body_jntnum
    while not joints[body] and parents[body]:
        body = int(parents[body])
    return body
