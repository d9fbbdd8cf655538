"""The ground of twins: the model's own answers, with errors that it makes on a finger of other constants.

The errors are those of another session, so they keep their distribution and their correlation in time and
between channels, but follow neither the force nor the place nor the past of the recording. What is found
in it was injected.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

import taxel
from taxel.channels import COUNTS_MAX
from taxel.manifest import Manifest
from taxel.windows.history import TOUCH_N
from taxel_models.ground.ground import ALL_CHANNELS, Clean, Floats, predicted
from taxel_models.recordings import Recording
from taxel_models.twin import simulate
from taxel_models.twin.constants import Constants
from taxel_models.twin.sensor import Sensor

WARM_S: Final = 4 * 3600.0
"""A finger that is switched on for so long no longer warms up."""

MOST_ON_FOR_S: Final = 3000.0
"""The longest time that a finger is switched on before a round."""

KINDS: Final = 5
"""Materials."""

REFERENCE_ROWS: Final = 20_000


@dataclass(frozen=True)
class StoredModel:
    """A model of a repository. It is opened in each process that predicts with it."""

    repository: Path
    name: str

    @cached_property
    def _predictor(self) -> taxel.Predictor:
        return taxel.load(self.repository).predictor(self.name)

    def __getstate__(self) -> dict[str, object]:
        return {"repository": self.repository, "name": self.name}

    @property
    def manifest(self) -> Manifest:
        """The model's."""
        return self._predictor.manifest

    def predict(self, windows: NDArray[np.float32]) -> NDArray[np.float32]:
        """(n, 21) counts of windows (n, f)."""
        return self._predictor.predict(windows)

    def predict_base(self, windows: NDArray[np.float32]) -> NDArray[np.float32]:
        """Without the effects of the manifest."""
        return self._predictor.predict_base(windows)


@dataclass(frozen=True)
class TwinGround:
    """Twins of `rows` rows whose errors are those of fingers of other constants."""

    model: StoredModel
    seed: int
    rows: int

    def clean(self, number: int) -> Clean:
        """A twin of its own for each round."""
        recording = self._recording(number, self.rows)
        return Clean(self.model, recording, self._reference, True, ALL_CHANNELS, contacts_of(recording))

    @cached_property
    def _reference(self) -> Recording:
        """One for all rounds."""
        return self._recording(-1, min(self.rows, REFERENCE_ROWS))

    def _recording(self, number: int, rows: int) -> Recording:
        random = np.random.default_rng([self.seed, number + 1, 3])
        first, second = (int(drawn) for drawn in random.integers(1 << 31, size=2))
        shown = simulate(rows, first, Constants(on_for_s=float(random.uniform(0.0, MOST_ON_FOR_S))))
        other = simulate(rows, second, other_constants(random))
        answers, kept = predicted(self.model, shown)
        wrong, same = predicted(self.model, other)
        errors: Floats = other.channels[same] - wrong
        errors -= errors.mean(axis=0)
        counts = np.clip(np.rint(answers + errors), 0, COUNTS_MAX)
        recording = replace(shown.rows(kept), name=f"twin-{number}", sha256="")
        recording = replace(recording, channels=counts)
        material = random.integers(1, KINDS + 1, rows)[contacts_of(recording)]
        return replace(recording, covariates={"material": material.astype(np.float64)})


def other_constants(random: np.random.Generator) -> Constants:
    """A warmed-up finger and a rig with other constants than those of the paper's data set."""
    sensor = Sensor.biotac_2p()
    moved = 0.15 * random.standard_normal(sensor.positions.shape)
    rest = sensor.electrode_rest * (1.0 + 0.03 * random.standard_normal(len(sensor.electrode_rest)))
    usual = Constants()
    factors = random.uniform(0.7, 1.4, 5)
    return Constants(
        sensor=replace(sensor, positions=sensor.positions + moved, electrode_rest=rest),
        tracking_mm=usual.tracking_mm * factors[0],
        force_noise_n=usual.force_noise_n * factors[1],
        fluid_lag_s=usual.fluid_lag_s * factors[2],
        pocket_spread=usual.pocket_spread * factors[3],
        carried_spread=usual.carried_spread * factors[4],
        on_for_s=WARM_S,
        cooling_k=0.0,
    )


def contacts_of(recording: Recording) -> NDArray[np.int64]:
    """(n,) the number of each row's contact: a touch, with the free air after it."""
    pressed = np.linalg.norm(recording.samples.force, axis=1) > TOUCH_N
    begins = pressed & ~np.concatenate([[False], pressed[:-1]])
    return np.cumsum(begins)
