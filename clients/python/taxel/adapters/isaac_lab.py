"""Isaac Lab 3.0: contact samples from a `ContactSensor`, by its documentation; not run with Isaac Lab.

The sensor is configured with `track_pose=True`, `track_contact_points=True` and `filter_prim_paths_expr`.
Where the physics knows no friction, forces are normal only.
"""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from taxel.adapters.frames import ON_THE_BODY, Mount, array
from taxel.contacts import ContactSample, fingertip_contacts


def contact_sample(
    data: Any, *, mount: Mount = ON_THE_BODY, last: ArrayLike | None = None, strict: bool = False
) -> ContactSample:
    """What touches the fingertips, environments x sensors of them in a row.

    Args:
        data: `ContactSensor.data`, with the documented shapes: `pos_w` (n, s, 3), `quat_w` (n, s, 4), the
            scalar last, `force_matrix_w` and `contact_pos_w` (n, s, filters, 3), NaN where nothing touches.
        mount: the sensor's frame on the body; by default, the body's own.
        last: (n * s, 3), the places of the last step.
        strict: contacts off the skin are an error, not a warning.

    Raises:
        InvalidArgument: the sensor gives none of these, as it is configured, or they have other shapes.
    """
    pose, filters = "track_pose=True", "filter_prim_paths_expr"
    position = array("pos_w", data.pos_w, (None, None, 3), pose)
    quaternion = array("quat_w", data.quat_w, (*position.shape[:2], 4), pose)
    forces = array("force_matrix_w", data.force_matrix_w, (*position.shape[:2], None, 3), filters)
    points = array(
        "contact_pos_w", data.contact_pos_w, forces.shape, f"track_contact_points=True and {filters}"
    )
    quaternion = quaternion.reshape(-1, 4)[:, [3, 0, 1, 2]]
    frames = mount.frames(position.reshape(-1, 3), quaternion)
    finger = np.repeat(np.arange(len(quaternion)), forces.shape[2])
    forces, points = forces.reshape(-1, 3), points.reshape(-1, 3)
    touching = np.isfinite(points).all(axis=1) & np.isfinite(forces).all(axis=1)
    return fingertip_contacts(
        points[touching], forces[touching], *frames, finger=finger[touching], last=last, strict=strict
    )
