"""Injection: adds an effect of a given strength to a recording's measured channels."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Final

import numpy as np

from taxel.channels import COUNTS_MAX
from taxel.errors import SettingsError
from taxel.windows import HistoryFeature, history_columns
from taxel_models.loop.basis import Floats
from taxel_models.loop.resting import resting
from taxel_models.recordings import Recording

USUAL_RESIDUAL: Final = 0.1
"""A good model's residual over the channel's standard deviation (the paper's normalised MAE)."""


@dataclass
class Injection:
    """A recording that effects are put into, one after another.

    Strength is the root mean square of what an effect changes over the residual that was there
    before, over the channels that it touches.

    Attributes:
        recording: of ticks; replaced as effects are added.
        random: draws the parameters.
        residual: (21,) root mean square of the residual without the effect, counts.
        strength: of the effect that is injected next.
        truth: what was injected so far.
        respond: what a model gives for other positions (n, 3), m, and forces (n, 3), N: (n, 21) counts; to
            scale effects of the inputs, which else keep to their usual size.
    """

    recording: Recording
    random: np.random.Generator
    residual: Floats
    strength: float = 1.0
    truth: list[dict[str, Any]] = field(default_factory=list)
    respond: Callable[[Floats, Floats], Floats] | None = None

    @classmethod
    def into(cls, recording: Recording, seed: int, residual: Floats | None = None) -> "Injection":
        """For a recording; if no residual is given, it is a tenth of each channel's standard deviation."""
        ticks = recording.ticks()
        usual = USUAL_RESIDUAL * ticks.channels.std(axis=0)
        found = usual if residual is None else residual
        return cls(ticks, np.random.default_rng(seed), np.maximum(found, 1e-6))

    @cached_property
    def pressed(self) -> Floats:
        """(n,) the force's magnitude, N."""
        return np.asarray(np.linalg.norm(self.recording.samples.force, axis=1))

    @cached_property
    def rest(self) -> Floats:
        """(21,) counts at rest; see `resting`."""
        return resting(self.pressed, self.recording.channels)

    @property
    def signal(self) -> Floats:
        """(n, 21) counts about rest."""
        return self.recording.channels - self.rest

    @cached_property
    def time_s(self) -> Floats:
        """(n,) since the first sample."""
        time = self.recording.samples.time_ns
        return np.asarray((time - time[0]) / 1e9)

    def history(self, feature: HistoryFeature) -> Floats:
        """(n,) a feature of the past."""
        return history_columns(self.recording.samples, [feature])[:, 0]

    def add(self, delta: Floats, weights: Mapping[str, Floats], **parameters: float | str) -> None:
        """Add a change that is linear in its weights, scaled to the strength.

        Args:
            delta: (n, 21) counts.
            weights: scaled as the change is.
            parameters: that are not scaled.
        """
        found = self.strength_of(delta)
        if not found > 0:
            raise SettingsError(
                "the effect changes nothing in this recording: what it depends on is constant"
            )
        scale = self.strength / found
        self._put(delta * scale)
        scaled = {name: (np.asarray(values) * scale).tolist() for name, values in weights.items()}
        self.truth[-1].update({"parameters": {**parameters, **scaled}})

    def turn_forces(self, force: Floats, **parameters: Any) -> None:
        """Change the recorded forces (n, 3), N, rather than the channels."""
        self._clear()
        samples = replace(self.recording.samples, force=force)
        self.recording = replace(self.recording, samples=samples)
        self.truth[-1].update({"parameters": parameters})

    def replace_channels(self, counts: Floats, **parameters: Any) -> None:
        """Take other counts (n, 21), as they are."""
        self._put(counts - self.recording.channels)
        self.truth[-1].update({"parameters": parameters})

    def begin(self, name: str, strength: float) -> None:
        """The next effect has this name and strength."""
        self.strength = strength
        self.truth.append({"name": name, "strength": strength})

    def strength_of(self, delta: Floats) -> float:
        """How strong a change (n, 21) is: its root mean square over the residual's, where it is any."""
        relative = np.sqrt((delta**2).mean(axis=0)) / self.residual
        touched = relative > 0
        return float(np.sqrt((relative[touched] ** 2).mean())) if touched.any() else 0.0

    def _put(self, delta: Floats) -> None:
        self._clear()
        counts = np.clip(np.rint(self.recording.channels + delta), 0, COUNTS_MAX)
        self.recording = replace(self.recording, channels=counts)

    def _clear(self) -> None:
        for name in ("pressed", "rest"):
            self.__dict__.pop(name, None)
