"""What all adapters share: tensors as NumPy arrays, and the sensor's frame on its body."""

from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray


def array(values: Any) -> NDArray[np.float64]:
    """A tensor of any device, or an array that knows its tensor (Isaac Lab's), as float64."""
    tensor = values.torch if hasattr(values, "torch") else values
    if hasattr(tensor, "detach"):
        tensor = tensor.detach().cpu()
    return np.asarray(tensor, np.float64)


def rotations(quaternions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rotation matrices (n, 3, 3) of quaternions (n, 4), the scalar first."""
    w, x, y, z = (quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)).T
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
