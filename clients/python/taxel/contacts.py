"""From a simulator's contacts to the sample that models take: one place and one force for each fingertip.

    from taxel.contacts import fingertip_contacts

    sample = fingertip_contacts(points, forces, position_of_sensor, rotation_of_sensor)
    channels = fingers.step(sample.position, sample.force)

A simulator reports any number of contact points. Models were trained on one contact at a time: its place
on the skin and its force, in the sensor's frame (`taxel.skin`). The rule that makes one of many:

1. A *patch* is all contacts within 6 mm of one of them, about the reach of one indentation. The patch with
   the largest sum of force magnitudes is taken. Others are left out: two contacts 20 mm apart are not one
   in the middle.
2. The force is the sum over the patch. The place is the mean over the patch, weighted by force magnitudes,
   moved to the nearest place on the skin.
3. Where nothing touches, the force is zero, and the place is the last one, or the middle of the pad.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from taxel.errors import InvalidArgument
from taxel.input_checks import warn
from taxel.skin import PAD, Fingertip, lengths
from taxel.trained_contacts import OFF_SKIN_M

PATCH_M: Final = 0.006
"""Contacts so near to each other are one contact, m."""

_ROTATION_TOLERANCE: Final = 1e-3
_PAD: Final = np.array(PAD)
_IDENTITY: Final = np.eye(3)
_ZERO: Final = np.zeros(1, np.int64)


@dataclass(frozen=True)
class ContactSample:
    """One contact for each of n fingertips, in the sensors' frames.

    Attributes:
        position: (n, 3), on the skin, m.
        force: (n, 3), on the finger, N; zero where nothing touches.
        touched: (n,), whether anything touches.
        height: (n,), mean distance of the contacts from the skin, m, before they were moved to it; 0 where
            nothing touches. Far from 0, the pose or the unit is wrong.
        left_out: (n,), the sum of force magnitudes outside the patch that was taken, N.
    """

    position: NDArray[np.float64]
    force: NDArray[np.float64]
    touched: NDArray[np.bool_]
    height: NDArray[np.float64]
    left_out: NDArray[np.float64]


def fingertip_contacts(
    points: ArrayLike,
    forces: ArrayLike,
    sensor_position: ArrayLike,
    sensor_rotation: ArrayLike,
    *,
    finger: ArrayLike | None = None,
    last: ArrayLike | None = None,
    strict: bool = False,
) -> ContactSample:
    """Make one contact for each fingertip from a simulator's contacts in the world frame.

    It warns (`taxel.errors.InputWarning`) of contacts that are off the skin.

    Args:
        points: (k, 3), where contacts are, m, world frame. k may be 0.
        forces: (k, 3), the force of each on the finger, N, world frame. Beware: many report its opposite.
        sensor_position: (3,) or (n, 3), the origin of each sensor's frame, m, world frame.
        sensor_rotation: (3, 3) or (n, 3, 3), from the sensor's frame to the world: columns are its axes.
        finger: (k,), which fingertip each contact is on, 0 to n - 1; all on fingertip 0 if not given.
        last: (n, 3), the places of the last step, for fingertips that nothing touches; the middle of
            the pad if not given.
        strict: what it would warn of is an error.

    Raises:
        InvalidArgument: a shape is wrong, a number is not finite, a rotation is none, or there is no such
            fingertip. Or contacts are off the skin, and `strict` is true.
    """
    points, forces = _rows("points", points), _rows("forces", forces)
    if len(points) != len(forces):
        raise InvalidArgument(f"{len(points)} points and {len(forces)} forces: expected as many of each")
    origins, rotations = _poses(sensor_position, sensor_rotation)
    count = len(origins)
    on = _fingers(finger, len(points), count)
    places = np.einsum("kji,kj->ki", rotations[on], points - origins[on])
    pushes = np.einsum("kji,kj->ki", rotations[on], forces)
    held = _PAD + np.zeros((count, 3)) if last is None else _rows("last", last).copy()
    if len(held) != count:
        raise InvalidArgument(f"last has {len(held)} places: expected one for each of {count} fingertips")
    sample = _sample(places, pushes, on, held)
    if (np.abs(sample.height) > OFF_SKIN_M).any():
        _tell_off_skin(places, strict=strict)
    return sample


def _tell_off_skin(places: NDArray[np.float64], *, strict: bool) -> None:
    """The text has no figures, so that Python shows it once."""
    heights = Fingertip.biotac_2p().height(places / 1e3)
    unit = np.mean(np.abs(heights) <= OFF_SKIN_M) > 0.5
    text = f"contacts are more than {OFF_SKIN_M * 1e3:g} mm off the skin: " + (
        "they look like millimetres, expected metres"
        if unit
        else "expected points of the fingertip, in m, and the pose of its sensor's frame"
    )
    if strict:
        raise InvalidArgument(text)
    warn(text)


def _sample(
    places: NDArray[np.float64],
    pushes: NDArray[np.float64],
    on: NDArray[np.int64],
    held: NDArray[np.float64],
) -> ContactSample:
    """From contacts in the sensors' frames; `held` (n, 3) becomes the positions."""
    skin, count = Fingertip.biotac_2p(), len(held)
    sizes = lengths(pushes)
    pressing = sizes > 0.0
    if not pressing.all():
        places, pushes, on, sizes = places[pressing], pushes[pressing], on[pressing], sizes[pressing]
    force, height, left_out = np.zeros((count, 3)), np.zeros(count), np.zeros(count)
    if not len(sizes):
        return ContactSample(held, force, np.zeros(count, np.bool_), height, left_out)
    if count > 1:
        # Contacts of one fingertip stand together, so that only they are compared.
        order = np.argsort(on, kind="stable")
        places, pushes, on, sizes = places[order], pushes[order], on[order], sizes[order]
    contacts, heights = np.bincount(on, minlength=count), skin.height(places)
    starts = np.concatenate([_ZERO, contacts.cumsum()])
    touched = contacts > 0
    first = starts[:-1][touched]
    held[touched], force[touched], height[touched] = places[first], pushes[first], heights[first]
    for one in np.flatnonzero(contacts > 1):
        own = slice(starts[one], starts[one + 1])
        near = lengths(places[own, None] - places[own]) <= PATCH_M
        patch = near[int(np.argmax(near @ sizes[own]))]
        weights = sizes[own] * patch
        held[one] = weights @ places[own] / weights.sum()
        force[one] = pushes[own][patch].sum(axis=0)
        height[one] = weights @ heights[own] / weights.sum()
        left_out[one] = sizes[own][~patch].sum()
    held[touched] = skin.nearest(held[touched])
    return ContactSample(held, force, touched, height, left_out)


def _array(name: str, values: ArrayLike) -> NDArray[np.float64]:
    try:
        return np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError, RuntimeError) as error:
        # A tensor on a GPU, or with gradients, says itself what to do with it.
        raise InvalidArgument(f"{name}: {error}: expected numbers on the CPU") from None


def _rows(name: str, values: ArrayLike) -> NDArray[np.float64]:
    array = _array(name, values)
    if array.ndim > 2 or (array.size and array.shape[-1:] != (3,)):
        raise InvalidArgument(f"{name} has shape {array.shape}: expected (k, 3)")
    rows = array.reshape(-1, 3)
    finite = np.isfinite(rows)
    if not finite.all():
        row = int(np.argmin(finite.all(axis=1)))
        raise InvalidArgument(f"{name}[{row}] is {rows[row].tolist()}: expected finite numbers")
    return rows


def _poses(positions: ArrayLike, rotations: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    origins = _rows("sensor_position", positions)
    turned = _array("sensor_rotation", rotations)
    if turned.size != 9 * len(origins):
        raise InvalidArgument(
            f"sensor_rotation has shape {turned.shape}: expected ({len(origins)}, 3, 3), a matrix for each "
            "sensor"
        )
    turned = turned.reshape(len(origins), 3, 3)
    near = np.abs(turned @ turned.transpose(0, 2, 1) - _IDENTITY) <= _ROTATION_TOLERANCE
    if not near.all() or (np.linalg.det(turned) < 0.0).any():
        wrong = ~near.all(axis=(1, 2)) | (np.linalg.det(turned) < 0.0)
        row = int(np.argmax(wrong))
        raise InvalidArgument(
            f"sensor_rotation[{row}] is {turned[row].tolist()}: expected a rotation matrix, with "
            "orthogonal unit columns and determinant 1"
        )
    return origins, turned


def _fingers(finger: ArrayLike | None, contacts: int, count: int) -> NDArray[np.int64]:
    if finger is None:
        return np.zeros(contacts, np.int64)
    on = np.asarray(finger)
    if on.shape != (contacts,) or (on.size and on.dtype.kind not in "iu"):
        raise InvalidArgument(
            f"finger is {on.dtype} of shape {on.shape}: expected ({contacts},) whole numbers"
        )
    if on.size and (on.min() < 0 or on.max() >= count):
        raise InvalidArgument(f"finger is {on.min()} to {on.max()}: expected 0 to {count - 1}")
    return on.astype(np.int64)
