"""The ground of the own injectors: a few twins without what the loop finds in them anyway.

The reference is such a twin, too. The model's manifest knows the residual of twins that still have all
that the model lacks, the temperature among it: a cause of that size would be told as usual.
"""

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
        recordings: how many different ones; one more is the reference.
        rows: of each.
    """

    model: Model
    seed: int
    rows: int
    recordings: int = 5
    _clean: dict[int, Recording] = field(default_factory=dict, repr=False)

    def clean(self, number: int) -> Clean:
        """The recording of a round."""
        recording, reference = self._twin(number % self.recordings), self._twin(self.recordings)
        return Clean(self.model, recording, reference, True, ALL_CHANNELS, contacts_of(recording))

    def _twin(self, which: int) -> Recording:
        if which not in self._clean:
            simulated = simulate(self.rows, 1000 * (self.seed + 1) + which)
            self._clean[which] = without_effects(self.model, simulated, which)
        return self._clean[which]
