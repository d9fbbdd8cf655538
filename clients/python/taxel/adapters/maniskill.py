"""ManiSkill 3: contact samples from its pairwise forces, by its documentation; not run with ManiSkill.

It tells no contact points. A contact is put where the skin faces its force, as without friction; on the
cylinder, where all places along the finger face alike, near its end.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from taxel.adapters.frames import ON_THE_BODY, Mount, array
from taxel.contacts import ContactSample, fingertip_contacts
from taxel.skin import Fingertip


def contact_sample(
    scene: Any,
    link: Any,
    objects: Sequence[Any],
    mount: Mount = ON_THE_BODY,
    last: ArrayLike | None = None,
    strict: bool = False,
) -> ContactSample:
    """What touches one fingertip in each of n environments.

    Args:
        scene: `env.unwrapped.scene`; `get_pairwise_contact_forces` gives forces on the first, (n, 3).
        link: the fingertip; `pose.p` is (n, 3), `pose.q` (n, 4), the scalar first.
        objects: what may touch it; each makes one contact.
        mount: the sensor's frame on the link; by default, the link's own.
        last: (n, 3), the places of the last step. strict: what looks wrong is an error.
    """
    position = array("link.pose.p", link.pose.p, (None, 3))
    shape = position.shape
    frames = mount.frames(position, array("link.pose.q", link.pose.q, (len(position), 4)))
    told = [array("forces", scene.get_pairwise_contact_forces(link, each), shape) for each in objects]
    forces = np.stack(told, axis=1)
    facing = -forces / np.maximum(np.linalg.norm(forces, axis=2, keepdims=True), np.finfo(float).tiny)
    points = (frames[0][:, None] + Fingertip.biotac_2p().radius * facing).reshape(-1, 3)
    on = np.repeat(np.arange(len(forces)), len(objects))
    return fingertip_contacts(points, forces.reshape(-1, 3), *frames, finger=on, last=last, strict=strict)
