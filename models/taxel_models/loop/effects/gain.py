"""Gain: a channel's sensitivity differs from the model's, or changes with age."""

from collections.abc import Iterable
from typing import Final

import numpy as np
from typing_extensions import override

from taxel.corrections import ONE
from taxel_models.loop.effects.course import along, has_long_pauses, recorded
from taxel_models.loop.effects.drivers import Driver, elapsed, evenly_filled, weighted
from taxel_models.loop.effects.effect import SHARED_WEIGHTS, Candidate, Effect, Fitting, Remaining
from taxel_models.loop.observations import Observations

PIECES: Final = 4
"""Straight pieces of an ageing gain: enough for a step, a ramp or a decay."""

AGEING_S: Final = 60.0
"""Shorter recordings are not searched for ageing."""

_CHANNELS: Final = {**SHARED_WEIGHTS, "by channel": Fitting()}
"""Which channels share the weights, by what a form's name says of it."""


class Gain(Effect):
    """measured - rest = (1 + g) (model - rest); with age, g grows with time."""

    name = "gain"
    follows = "expected"
    equation = "delta_c = (g_c + a_c t) (p_c - rest_c)"
    source = "definition; gain acts on the change about rest, since rest is tared or known apart"
    signature = "the residual is in proportion to the channel's own signal, and zero in free air"

    @override
    def forms(self, observations: Observations, remaining: Remaining) -> Iterable[Candidate]:
        constant = Driver(ONE, np.ones(len(observations)))
        for channels, fitting in _CHANNELS.items():
            yield weighted(
                observations,
                self.name,
                channels,
                "signal",
                [constant],
                centred=False,
                fitting=fitting,
                weight_names=("gain",),
                weight_units=("relative",),
            )
        span = float(observations.time_s.max())
        if span > AGEING_S:
            for pieces in (1, PIECES):
                ageing = elapsed(observations, evenly_filled(observations, pieces))
                for channels, fitting in _CHANNELS.items():
                    yield weighted(
                        observations,
                        self.name,
                        f"ageing along {_course(pieces)}, {channels}",
                        "signal",
                        [constant, *ageing],
                        centred=False,
                        fitting=fitting,
                        weight_names=("gain", *(driver.weight_name for driver in ageing)),
                        weight_units=("relative", *("relative/s",) * len(ageing)),
                        ages=True,
                    )
            if has_long_pauses(observations):
                edges, recorded_s = recorded(observations)
                for channels, fitting in _CHANNELS.items():
                    yield along(
                        observations,
                        self.name,
                        f"ageing in recorded time, {channels}",
                        "signal",
                        edges,
                        recorded_s / recorded_s[-1],
                        beside=[constant],
                        centred=False,
                        fitting=fitting,
                        weight_names=("gain", "change"),
                        weight_units=("relative",),
                        ages=True,
                    )


def _course(pieces: int) -> str:
    return "a line" if pieces == 1 else f"{pieces} straight pieces"
