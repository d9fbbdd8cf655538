"""A foreign injection: puts a cause of a given strength into a recording of a ground."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from taxel.channels import CHANNELS, COUNTS_MAX, ELECTRODE_COLUMNS
from taxel.errors import SettingsError
from taxel.windows.history import TICK_S
from taxel_models.recordings import Recording

Floats = NDArray[np.float64]

Respond = Callable[[Floats, Floats], Floats]

TARED: Final = 500.0
"""Electrodes at rest read 2300 to 3500 counts; below this mean they are differences from rest."""

ROUNDING: Final = 1e-9
"""A smaller strength, before it is scaled, is what rounding leaves of a constant."""

LEAST_DEVIATION: Final = 0.3
"""Counts: that of a whole number drawn from a constant."""


@dataclass
class ForeignInjection:
    """A recording that causes are put into, one after another.

    The strength of a cause is the standard deviation of what it changes over that of the clean residual,
    its root mean square over the channels that it touches.

    Attributes:
        recording: of ticks; replaced as causes are added.
        random: draws the parameters.
        deviation: (21,) standard deviation of the clean residual, counts.
        contact: (n,) the number of each row's contact.
        live: (21,) which channels were measured.
        on_skin: whether positions lie on the finger's skin.
        respond: what the model gives for other positions (n, 3), m, and forces (n, 3), N: (n, 21) counts.
        strength: of the cause that is added next.
        parameters: of the causes added so far, by their names.
    """

    recording: Recording
    random: np.random.Generator
    deviation: Floats
    contact: NDArray[np.int64]
    live: NDArray[np.bool_]
    on_skin: bool
    respond: Respond
    strength: float = 1.0
    parameters: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.deviation = np.maximum(self.deviation, LEAST_DEVIATION)

    def __len__(self) -> int:
        return len(self.recording)

    @property
    def counts(self) -> Floats:
        """(n, 21) measured."""
        return self.recording.channels

    @cached_property
    def load(self) -> Floats:
        """(n,) the force's magnitude, N."""
        return np.asarray(np.linalg.norm(self.recording.samples.force, axis=1))

    @cached_property
    def time_s(self) -> Floats:
        """(n,) since the first row."""
        time = self.recording.samples.time_ns
        return np.asarray((time - time[0]) / 1e9)

    @property
    def tared(self) -> bool:
        """Whether electrodes are differences from rest."""
        return bool(self.counts[:, ELECTRODE_COLUMNS].mean() < TARED)

    @property
    def unloaded(self) -> Floats:
        """(21,) counts under the least twentieth of the loads; 0 where electrodes are tared."""
        if self.tared:
            return np.zeros(len(CHANNELS))
        light = self.load <= np.quantile(self.load, 0.05)
        return np.asarray(self.counts[light].mean(axis=0))

    @property
    def signal(self) -> Floats:
        """(n, 21) counts over those of an unloaded finger."""
        return self.counts - self.unloaded

    @property
    def electrodes(self) -> NDArray[np.int64]:
        """The columns of the electrodes, in random order."""
        return self.random.permutation(np.arange(len(CHANNELS))[ELECTRODE_COLUMNS])

    def in_segments(self, change: Callable[[Floats], Floats], column: Floats) -> Floats:
        """A column (n,) or (n, k) that is changed in each segment by itself."""
        return np.concatenate([change(column[part]) for part in self.recording.segments])

    def low_passed(self, column: Floats, time_constant_s: float, *, from_rest: bool = False) -> Floats:
        """A column (n,) or (n, k) behind a first-order filter.

        Args:
            from_rest: whether it starts at 0 in each segment; else settled.
        """
        keep = float(np.exp(-TICK_S / time_constant_s))

        def low_pass(part: Floats) -> Floats:
            first = keep * part[:1] * (not from_rest)
            return np.asarray(lfilter([1.0 - keep], [1.0, -keep], part, axis=0, zi=first)[0])

        return self.in_segments(low_pass, column)

    def free_weights(self) -> Floats:
        """(21,) of any size and sign, counts."""
        return self.random.standard_normal(len(CHANNELS)) * self.deviation

    def like_weights(self, sd: float) -> Floats:
        """(21,) of one sign, counts."""
        sign = self.random.choice([-1.0, 1.0])
        factors = np.maximum(1.0 + sd * self.random.standard_normal(len(CHANNELS)), 0.2)
        return np.asarray(sign * factors * self.deviation)

    def add(self, change: Floats, **parameters: Any) -> None:
        """Add a change (n, 21), counts, less its mean and scaled to the strength.

        A model that was trained while the cause acted has absorbed its mean.

        Raises:
            SettingsError: it changes nothing in this recording.
        """
        self.add_whole(change - change.mean(axis=0), **parameters)

    def add_whole(self, change: Floats, **parameters: Any) -> None:
        """The same with its mean, for a constant."""
        found = self.strength_of(change)
        if not found > ROUNDING:
            raise SettingsError("the cause changes nothing here: what it depends on is constant")
        self._put(change * (self.strength / found), parameters)

    def add_nearest(self, changes: Iterable[tuple[float, Floats]], name: str, **parameters: Any) -> None:
        """Of several changes (n, 21), add the one nearest to the strength, less its mean, as it is."""
        best: tuple[float, float, Floats] | None = None
        for value, change in changes:
            without = change - change.mean(axis=0)
            apart = abs(np.log(max(self.strength_of(without), 1e-9) / self.strength))
            if best is None or apart < best[0]:
                best = apart, value, without
        if best is None:
            raise SettingsError(f"no {name} to choose from")
        self._put(best[2], {name: best[1], **parameters})

    def replace_one(self, changed: dict[int, Floats], **parameters: Any) -> None:
        """Of several channels' new counts (n,), take one of the three nearest to the strength, as it is."""
        apart = []
        for channel, counts in changed.items():
            change = np.zeros_like(self.counts)
            change[:, channel] = counts - self.counts[:, channel]
            apart.append(abs(np.log(max(self.strength_of(change), 1e-9) / self.strength)))
        nearest = np.argsort(apart)[:3]
        channel = list(changed)[int(self.random.choice(nearest))]
        change = np.zeros_like(self.counts)
        change[:, channel] = np.rint(changed[channel]) - self.counts[:, channel]
        self._put(change, {"channel": CHANNELS[channel], **parameters})

    def replace_counts(self, counts: Floats, **parameters: Any) -> None:
        """Take other counts (n, 21), as they are."""
        self._put(counts - self.counts, parameters)

    def replace_inputs(self, position: Floats, force: Floats, **parameters: Any) -> None:
        """Change what was recorded of the contact rather than the channels."""
        samples = replace(self.recording.samples, position=position, force=force)
        self._keep(replace(self.recording, samples=samples), parameters)

    def replace_temperature(self, tdc: Floats) -> None:
        """Change the recorded temperature (n,), counts."""
        auxiliary = {**self.recording.auxiliary, "tdc": np.clip(np.rint(tdc), 0, COUNTS_MAX)}
        self._keep(replace(self.recording, auxiliary=auxiliary), {})

    def strength_of(self, change: Floats) -> float:
        """How strong a change (n, 21) is, over the live channels that it touches."""
        touched = self.live & (np.abs(change).max(axis=0) > 0)
        if not touched.any():
            return 0.0
        relative = np.sqrt((change[:, touched] ** 2).mean(axis=0)) / self.deviation[touched]
        return float(np.sqrt((relative**2).mean()))

    def _put(self, change: Floats, parameters: dict[str, Any]) -> None:
        counts = np.clip(np.rint(self.counts + change * self.live), 0, COUNTS_MAX)
        counts[:, ~self.live] = self.counts[:, ~self.live]
        reached = self.strength_of(counts - self.counts)
        self._keep(replace(self.recording, channels=counts), {**parameters, "reached": reached})

    def _keep(self, recording: Recording, parameters: dict[str, Any]) -> None:
        self.recording = recording
        self.__dict__.pop("load", None)
        self.parameters.update(parameters)
