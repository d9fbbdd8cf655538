"""A ground: a model, and recordings that it was not trained on."""

from dataclasses import dataclass
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from taxel.channels import CHANNELS
from taxel.manifest import Manifest
from taxel.windows import build_windows, extra_columns
from taxel_models.recordings import Recording

Floats = NDArray[np.float64]

ALL_CHANNELS: Final[tuple[bool, ...]] = (True,) * len(CHANNELS)


class Model(Protocol):
    """What a ground gives to the loop, such as a predictor of `taxel.load`."""

    @property
    def manifest(self) -> Manifest:
        """Everything known of the model."""

    def predict(self, windows: NDArray[np.float32]) -> NDArray[np.float32]:
        """(n, 21) counts of windows (n, f)."""

    def predict_base(self, windows: NDArray[np.float32]) -> NDArray[np.float32]:
        """(n, 21) counts of the same windows without the effects of the manifest."""


@dataclass(frozen=True)
class Clean:
    """A recording into which something is injected.

    Attributes:
        model: was not trained on the recording.
        recording: of ticks.
        reference: another recording that the model was not trained on, with nothing injected; None where
            there is none.
        on_skin: whether positions lie on the skin; else they are poses of a robot.
        live: (21,) which channels were measured; the others are noise about a constant.
        contact: (n,) the number of each row's contact.
    """

    model: Model
    recording: Recording
    reference: Recording | None
    on_skin: bool
    live: tuple[bool, ...]
    contact: NDArray[np.int64]


class Ground(Protocol):
    """Gives a clean recording for each round. It is sent to other processes."""

    def clean(self, number: int) -> Clean:
        """The recording of a round; the same for the same number."""


def predicted(model: Model, recording: Recording) -> tuple[Floats, NDArray[np.int64]]:
    """The model's counts (m, 21) at the ticks (m,) of a recording that have a whole window."""
    layout = model.manifest.window
    built = build_windows(recording.samples, model.manifest.spec)
    columns = {**recording.auxiliary, **recording.covariates}
    extras = extra_columns(recording.samples, layout.extras, columns)[built.rows]
    windows = np.column_stack([built.values, extras]).astype(np.float32)
    parts = [model.predict(windows[start : start + 4096]) for start in range(0, len(windows), 4096)]
    return np.concatenate(parts).astype(np.float64)[:, : len(CHANNELS)], built.rows
