"""The ground of the own injectors: a few twins without what the loop finds in them anyway."""

from dataclasses import dataclass, field

from taxel_models.ground.ground import ALL_CHANNELS, Clean, Model
from taxel_models.ground.twins import contacts_of
from taxel_models.recordings import Recording
from taxel_models.recovery.naming import settled
from taxel_models.twin import simulate


@dataclass(frozen=True)
class SettledTwins:
    """Twins of the paper's constants, taken in turn.

    Attributes:
        recordings: how many different ones.
        rows: of each.
    """

    model: Model
    seed: int
    rows: int
    recordings: int = 5
    _settled: dict[int, Recording] = field(default_factory=dict, repr=False)

    def clean(self, number: int) -> Clean:
        """The recording of a round."""
        which = number % self.recordings
        if which not in self._settled:
            simulated = simulate(self.rows, 1000 * (self.seed + 1) + which)
            self._settled[which] = settled(self.model, simulated, which)
        recording = self._settled[which]
        return Clean(self.model, recording, None, True, ALL_CHANNELS, contacts_of(recording))
