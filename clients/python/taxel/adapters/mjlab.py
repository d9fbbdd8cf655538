"""mjlab 1.6: contact samples from a `ContactSensor`, by its documentation; not run with mjlab.

The sensor is configured with `fields=("found", "force", "pos")` and `reduce="netforce"`, or with
`num_slots` above 1 and `global_frame=True`, so that contacts far apart are told from each other.
"""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from taxel.adapters.frames import ON_THE_BODY, array
from taxel.contacts import ContactSample, fingertip_contacts


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
    """
    position, quaternion = array(site_position).reshape(-1, 3), array(site_quaternion).reshape(-1, 4)
    found = array(data.found).reshape(-1) > 0
    on = np.repeat(np.arange(len(position)), len(found) // len(position))[found]
    # MuJoCo tells what the primary does to the other.
    forces, points = -array(data.force).reshape(-1, 3), array(data.pos).reshape(-1, 3)
    frames = ON_THE_BODY.frames(position, quaternion)
    return fingertip_contacts(points[found], forces[found], *frames, finger=on, last=last, strict=strict)
