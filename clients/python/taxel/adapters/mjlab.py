"""mjlab 1.6: contact samples from a `ContactSensor`, by its documentation; not run with mjlab.

The sensor is configured with `fields=("found", "force", "pos")` and `reduce="netforce"`, or with
`num_slots` above 1 and `global_frame=True`, so that contacts far apart are told from each other.
"""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from taxel.adapters.frames import ON_THE_BODY, array
from taxel.contacts import ContactSample, fingertip_contacts
from taxel.errors import InvalidArgument


def contact_sample(
    data: Any,
    site_position: Any,
    site_quaternion: Any,
    *,
    last: ArrayLike | None = None,
    strict: bool = False,
) -> ContactSample:
    """What touches the fingertips, environments x primaries of them in a row.

    Args:
        data: `ContactSensor.data`, with the documented shapes: `found` (b, n), `force` and `pos` (b, n, 3),
            the slots of a primary in a row.
        site_position: (b, p, 3), `entity.data.site_pos_w` of each primary's site: the sensor's frame.
        site_quaternion: (b, p, 4), `entity.data.site_quat_w`, the scalar first.
        last: (b * p, 3), the places of the last step.
        strict: contacts off the skin are an error, not a warning.

    Raises:
        InvalidArgument: the sensor gives none of these, as it is configured, or they have other shapes.
    """
    position = array("site_position", site_position, (None, None, 3))
    environments, primaries = position.shape[:2]
    quaternion = array("site_quaternion", site_quaternion, (environments, primaries, 4))
    fields = 'fields=("found", "force", "pos")'
    found = array("found", data.found, (environments, None), fields) > 0
    contacts = found.shape[1]
    if contacts % max(primaries, 1):
        raise InvalidArgument(
            f"found has shape {found.shape}: expected as many slots for each of {primaries} primaries"
        )
    on = np.repeat(np.arange(environments * primaries), contacts // max(primaries, 1))[found.ravel()]
    # MuJoCo tells what the primary does to the other.
    forces = -array("force", data.force, (environments, contacts, 3), fields)
    points = array("pos", data.pos, (environments, contacts, 3), fields)
    frames = ON_THE_BODY.frames(position.reshape(-1, 3), quaternion.reshape(-1, 4))
    return fingertip_contacts(points[found], forces[found], *frames, finger=on, last=last, strict=strict)
