"""A frame that is turned, shifted or scaled against the one that the base model knows."""

from functools import cached_property
from typing import Annotated, Final

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, PositiveFloat

from taxel.schema import Matrix, Schema, Vector
from taxel.windows import WindowSpec

_ORTHONORMAL: Final = 1e-6
"""How far a rotation times its transpose may be from the identity."""


def _orthogonal(matrix: Matrix) -> Matrix:
    array = np.array(matrix)
    # No entry of a rotation is above 1; products of very large ones would be no numbers.
    if np.abs(array).max() > 1 + _ORTHONORMAL or np.abs(array @ array.T - np.eye(3)).max() > _ORTHONORMAL:
        raise ValueError(f"{[list(row) for row in matrix]}: expected a rotation, which may also mirror")
    return matrix


Orthogonal = Annotated[Matrix, AfterValidator(_orthogonal)]


class Frame(Schema):
    """Every position and force of a window, before the base model sees it.

    position' = position_rotation @ position + position_translation, m;
    force' = force_scale * force_rotation @ force + force_translation, N.

    Where an axis has the wrong sign, a rotation also mirrors: its determinant is -1.
    """

    position_rotation: Orthogonal
    position_translation: Vector
    force_rotation: Orthogonal
    force_translation: Vector = (0.0, 0.0, 0.0)
    force_scale: PositiveFloat = 1.0

    def turn(self, windows: NDArray[np.float32], spec: WindowSpec) -> NDArray[np.float32]:
        """Windows in the base model's frame.

        Args:
            windows: (n, f), columns as `spec.features`; what follows them is kept.

        Returns:
            (n, f), C-contiguous.
        """
        positions = 3 * len(spec.positions)
        turned = windows.copy()
        for columns, matrix, translation in zip(
            (slice(0, positions), slice(positions, spec.length)),
            self._matrices,
            self._translations,
            strict=True,
        ):
            own = windows[:, columns].astype(np.float64)
            turned[:, columns] = (own.reshape(-1, 3) @ matrix.T + translation).reshape(own.shape)
        return turned

    @cached_property
    def _matrices(self) -> NDArray[np.float64]:
        """Of positions and of forces, (2, 3, 3)."""
        return np.array([self.position_rotation, self.force_scale * np.array(self.force_rotation)])

    @cached_property
    def _translations(self) -> NDArray[np.float64]:
        """Of positions, m, and of forces, N, (2, 3)."""
        return np.array([self.position_translation, self.force_translation])
