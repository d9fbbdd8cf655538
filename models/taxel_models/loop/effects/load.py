"""Load: a channel responds more or less to the force, whatever its own signal is."""

from collections.abc import Iterable
from typing import Final

import numpy as np
from typing_extensions import override

from taxel.windows import Load as LoadFeature
from taxel.windows import LoadAbove
from taxel.windows.history import TOUCH_N
from taxel_models.loop.effects.drivers import past, weighted
from taxel_models.loop.effects.effect import Candidate, Effect, Remaining
from taxel_models.loop.observations import Observations

QUANTILES: Final = (0.35, 0.5, 0.65, 0.8, 0.9)
"""Quantiles of the force while touched: the levels beyond which a channel may respond otherwise."""


class Load(Effect):
    """measured = model + w |F|, or w max(|F| - F_0, 0).

    What follows the force late, a creep or a hysteresis, must be likelier than this to be named.
    """

    name = "load"
    equation = "delta_c = w_c |F|, or w_c max(|F| - F_0, 0)"
    source = (
        "definition; beyond some force the skin meets the core, near 2 N (SynTouch manual): a bent line"
    )
    signature = (
        "the residual is in proportion to the force, or to what is above a level of it, at any speed"
    )

    @override
    def forms(self, observations: Observations, remaining: Remaining) -> Iterable[Candidate]:
        force = past(observations, LoadFeature(of="force"), "force", "N")
        yield weighted(observations, self.name, "by force", "unit", [force], weight_units=("counts/N",))
        touched = remaining.fit & (observations.pressed > TOUCH_N)
        levels = np.quantile(observations.pressed[touched], QUANTILES) if touched.any() else np.empty(0)
        for text in dict.fromkeys(f"{level:.3g}" for level in levels):
            above = LoadAbove(of="force", above_n=float(text))
            yield weighted(
                observations,
                self.name,
                f"by force above {text} N",
                "unit",
                [past(observations, above, f"force[{text}N:]", "N")],
                form_parameters={"level": (above.above_n, "N")},
                weight_names=("slope",),
                weight_units=("counts/N",),
            )
