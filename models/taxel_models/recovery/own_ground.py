"""The ground of the own injectors: a few twins without what the loop finds in them anyway."""

from dataclasses import dataclass, field

from taxel_models.ground.ground import ALL_CHANNELS, Clean
from taxel_models.ground.twins import contacts_of
from taxel_models.model import Model
from taxel_models.recordings import Recording
from taxel_models.recovery.naming import without_effects
from taxel_models.twin import simulate


@dataclass(frozen=True)
class CleanTwins:
    """Twins of the paper's constants, taken in turn.

    Attributes:
        recordings: how many different ones.
        rows: of each.
    """

    model: Model
    seed: int
    rows: int
    recordings: int = 5
    _clean: dict[int, Recording] = field(default_factory=dict, repr=False)

    def clean(self, number: int) -> Clean:
        """The recording of a round."""
        which = number % self.recordings
        if which not in self._clean:
            simulated = simulate(self.rows, 1000 * (self.seed + 1) + which)
            self._clean[which] = without_effects(self.model, simulated, which)
        recording = self._clean[which]
        return Clean(self.model, recording, None, True, ALL_CHANNELS, contacts_of(recording))
