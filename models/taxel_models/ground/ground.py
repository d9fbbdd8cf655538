"""A ground: a model, and recordings that it was not trained on."""

from dataclasses import dataclass
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from taxel.channels import CHANNELS
from taxel.windows import build_windows
from taxel_models.model import Model, predict_all
from taxel_models.recordings import Recording

Floats = NDArray[np.float64]

ALL_CHANNELS: Final[tuple[bool, ...]] = (True,) * len(CHANNELS)


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
        fitted: what the model was trained on, if that is known.
        base_model: the number of the model, where a ground has several.
    """

    model: Model
    recording: Recording
    reference: Recording | None
    on_skin: bool
    live: tuple[bool, ...]
    contact: NDArray[np.int64]
    fitted: Recording | None = None
    base_model: int = 0


class Ground(Protocol):
    """Gives a clean recording for each round. It is sent to other processes."""

    def clean(self, number: int) -> Clean:
        """The recording of a round; the same for the same number."""


def predicted(model: Model, recording: Recording) -> tuple[Floats, NDArray[np.int64]]:
    """The model's counts (m, 21) at the ticks (m,) of a recording that have a whole window."""
    layout = model.manifest.window
    columns = {**recording.auxiliary, **recording.covariates}
    windows = build_windows(recording.samples, layout.spec, layout.extras, columns)
    return predict_all(model.predict, windows.values), windows.rows
