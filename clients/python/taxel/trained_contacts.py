"""Which contacts a model was trained on: ranges, the rate, and whether they lie on the skin."""

from typing import Annotated, Any, Final, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, FiniteFloat, model_validator

from taxel.schema import Positive, Schema
from taxel.skin import Fingertip, off_axis

TOUCHED_N: Final = 0.3
"""A contact counts from this force on, N: below it, noise decides where a tracker sees the contact."""

OFF_SKIN_M: Final = 0.004
"""A place further from the skin than this is off the skin, m: it is 3 mm thick, and trackers err."""

Share = Annotated[float, Field(ge=0, le=1)]


class Range(Schema):
    """The smallest and the largest value of a quantity."""

    low: FiniteFloat
    high: FiniteFloat

    @model_validator(mode="after")
    def _is_in_order(self) -> Self:
        if self.low > self.high:
            raise ValueError(f"low {self.low} is above high {self.high}")
        return self

    @classmethod
    def of(cls, values: NDArray[Any]) -> Self:
        """Of (n,) numbers, n above 0."""
        return cls(low=float(values.min()), high=float(values.max()))

    @property
    def width(self) -> float:
        """From the smallest to the largest value."""
        return self.high - self.low


class TrainedContacts(Schema):
    """Which contacts a model was trained on, so that others can be told from them.

    Attributes:
        period_ms: the interval between recorded samples.
        x, y, z: of places that are touched with at least `TOUCHED_N`, sensor's frame, m.
        fx, fy, fz, force: the force's axes and its magnitude, N.
        extras: of further recorded columns that the model may take, such as `tdc`, counts.
        kinds: values of the recorded columns that name kinds, such as `material`; none where an older Taxel
            trained the model.
        skin_radius: of the skin that they were compared with, a cylinder along -x that a hemisphere closes
            (`taxel.skin`), m; None where an older Taxel trained the model.
        on_skin: the share of touched places that lie on this skin, within `OFF_SKIN_M`.
        pressing: the share of touches whose force points into the finger.
    """

    period_ms: Positive
    x: Range
    y: Range
    z: Range
    fx: Range
    fy: Range
    fz: Range
    force: Range
    extras: dict[str, Range] = Field(default_factory=dict)
    kinds: dict[str, tuple[FiniteFloat, ...]] = Field(default_factory=dict)
    skin_radius: Positive | None = None
    on_skin: Share
    pressing: Share

    @classmethod
    def of(
        cls,
        position: NDArray[np.float64],
        force: NDArray[np.float64],
        extras: dict[str, NDArray[np.float64]],
        period_ms: float,
        kinds: dict[str, tuple[float, ...]] | None = None,
    ) -> Self:
        """Of samples (n, 3), m, and (n, 3), N, n above 0. If no touch is firm, all count as touches."""
        magnitude = np.linalg.norm(force, axis=1)
        touched = magnitude >= TOUCHED_N
        if not touched.any():
            touched[:] = True
        places, pushes = position[touched], force[touched]
        skin = Fingertip.biotac_2p()
        ranges = {name: Range.of(column) for name, column in zip("xyz", places.T, strict=True)}
        ranges |= {f"f{axis}": Range.of(column) for axis, column in zip("xyz", force.T, strict=True)}
        return cls(
            period_ms=period_ms,
            **ranges,
            force=Range.of(magnitude),
            extras={name: Range.of(column) for name, column in extras.items()},
            kinds=kinds or {},
            skin_radius=skin.radius,
            on_skin=float((np.abs(skin.height(places)) <= OFF_SKIN_M).mean()),
            pressing=float((outward(places, pushes) < 0.0).mean()),
        )


def outward(places: NDArray[np.float64], forces: NDArray[np.float64]) -> NDArray[np.float64]:
    """The part of forces (n, 3) along the skin's outward normal at places (n, 3): negative of a press."""
    away = off_axis(places)
    length = np.sqrt(np.einsum("ij,ij->i", away, away))
    return np.asarray(np.einsum("ij,ij->i", away, forces) / np.maximum(length, np.finfo(float).tiny))
