"""Load: a channel responds more or less to the force, whatever its own signal is."""

from collections.abc import Iterable

from typing_extensions import override

from taxel.windows import Load as LoadFeature
from taxel_models.loop.effects.effect import Candidate, Effect, Remaining, past, weighted
from taxel_models.loop.observations import Observations


class Load(Effect):
    """measured = model + w |F|.

    What follows the force late, a creep or a hysteresis, must be likelier than this to be named.
    """

    name = "load"
    equation = "delta_c = w_c |F|"
    source = "definition"
    signature = "the residual is in proportion to the force, at any place and at any speed"

    @override
    def forms(self, observations: Observations, remaining: Remaining) -> Iterable[Candidate]:
        force = past(observations, LoadFeature(of="force"), "force", "N")
        yield weighted(observations, self.name, "by force", "unit", [force], weight_units=("counts/N",))
