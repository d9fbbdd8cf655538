"""What all adapters share: tensors as NumPy arrays, and the sensor's frame on its body."""

from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from taxel.errors import InvalidArgument


def array(name: str, values: Any, shape: tuple[int | None, ...], needs: str = "") -> NDArray[np.float64]:
    """A tensor of any device, or an array that knows its tensor (Isaac Lab's), as float64.

    Args:
        name: of the values, for errors.
        values: the tensor or array.
        shape: that is expected; None stands for any number.
        needs: what has to be set for the simulator to give it.

    Raises:
        InvalidArgument: there are no values, or they have another shape.
    """
    wanted = ", ".join("n" if size is None else str(size) for size in shape)
    if values is None:
        raise InvalidArgument(f"{name} is None: expected a tensor ({wanted}){needs and ', with '}{needs}")
    tensor = values.torch if hasattr(values, "torch") else values
    if hasattr(tensor, "detach"):
        tensor = tensor.detach().cpu()
    found: NDArray[np.float64] = np.asarray(tensor, np.float64)
    if found.ndim != len(shape) or any(
        size not in (None, own) for size, own in zip(shape, found.shape, strict=True)
    ):
        raise InvalidArgument(f"{name} has shape {found.shape}: expected ({wanted})")
    return found


def rotations(quaternions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rotation matrices (n, 3, 3) of quaternions (n, 4), the scalar first."""
    sizes = np.linalg.norm(quaternions, axis=1, keepdims=True)
    if not (sizes > 0.0).all():
        raise InvalidArgument(
            f"the quaternion {quaternions[int(np.argmin(sizes))].tolist()} is no rotation: expected unit "
            "quaternions, which a simulator has after its first update"
        )
    w, x, y, z = (quaternions / sizes).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), 2, 0)


@dataclass(frozen=True)
class Mount:
    """The sensor's frame in its body's: `position` (3,), m, and `rotation` (3, 3)."""

    position: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))
    rotation: NDArray[np.float64] = field(default_factory=lambda: np.eye(3))

    def frames(
        self, position: NDArray[np.float64], quaternion: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """The sensors' poses of bodies: positions (n, 3) and quaternions (n, 4), the scalar first."""
        turned = rotations(quaternion)
        return position + turned @ self.position, turned @ self.rotation


ON_THE_BODY: Final = Mount()
"""The sensor's frame is the body's own."""
