"""Temperature: it changes the fluid's conductivity, and so the impedance of every electrode."""

from collections.abc import Iterable
from itertools import product
from typing import Final

from typing_extensions import override

from taxel.windows import Relaxation, Warmth
from taxel.windows.history import Starts
from taxel_models.loop.effects.drift import PIECES, SHORTEST_S
from taxel_models.loop.effects.drivers import elapsed, evenly_filled, given, past, weighted
from taxel_models.loop.effects.effect import ELECTRODES_ALIKE, Candidate, Effect, Remaining
from taxel_models.loop.observations import Observations

TDC: Final = "tdc"
COOLING_S: Final = 8.0
"""How long a contact takes to cool the core. The seconds are the twin's assumption."""

RATES_S: Final = (3.0, 10.0, 30.0, 100.0)
"""Time constants that contact may warm and air may cool the skin with, half a decade apart."""

SLOWER_FROM_REST: Final = 2.0
"""How much longer time constants may be after a start from rest: it shows more of a slow warming."""

WARMING: Final = "warming"
"""The form parameter of a skin that contact warms."""

ALIKE: Final = 0.35
"""The largest SD over mean of the electrodes' slopes: they share the fluid. On LASA's idle finger, ln Z of
all electrodes fell by 21 to 24 %."""

LEAST_COUNTS: Final = 2.0
"""A smaller standard deviation of tdc is its own noise."""


class Temperature(Effect):
    """A shift of ln Z, proportional to the measured temperature. Tared channels have a shift of counts."""

    name = "temperature"
    equation = (
        "ln Z_c = ln Z_c(model) + k_c (tdc - mean), or k warmth; delta_c = dE/dlnZ k_c (tdc - mean); "
        "tared: delta_c = k_c (tdc - mean), or k warmth"
    )
    source = "LASA's idle finger: warming lowers ln Z of all electrodes alike; -2 %/K (unverified)"
    signature = "the residual follows tdc or past touches, common to all electrodes in ln Z"

    @override
    def forms(self, observations: Observations, remaining: Remaining) -> Iterable[Candidate]:
        values = observations.covariates.get(TDC)
        if values is None:
            if observations.raw_counts:
                yield from self._by_state(observations)
        elif values.std() < LEAST_COUNTS:
            return
        else:
            yield from self._as_measured(observations)
        yield from self._by_contact(observations)

    def _as_measured(self, observations: Observations) -> Iterable[Candidate]:
        driver = given(observations, TDC, "counts")
        if observations.raw_counts:
            yield weighted(
                observations,
                self.name,
                "electrodes alike, in ln Z",
                "log_impedance",
                [driver],
                fitting=ELECTRODES_ALIKE,
                weight_names=("slope",),
                weight_units=("ln Z per tdc count",),
            )
            yield weighted(
                observations,
                self.name,
                "by channel, in ln Z",
                "log_impedance",
                [driver],
                weight_names=("slope",),
                weight_units=("ln Z per tdc count; counts per tdc count for pac0 and pdc",),
                alike=ALIKE,
            )
        else:
            yield weighted(
                observations,
                self.name,
                "by channel",
                "unit",
                [driver],
                weight_names=("slope",),
                weight_units=("counts per tdc count",),
            )

    def _by_state(self, observations: Observations) -> Iterable[Candidate]:
        """Without a measured temperature: the finger warms up after the start; contact cools it."""
        if float(observations.time_s.max()) < SHORTEST_S:
            return
        edges = evenly_filled(observations, PIECES)
        drivers = elapsed(observations, edges)
        cooling = Relaxation(of="force", time_constant_s=COOLING_S)
        drivers.append(past(observations, cooling, f"relaxation[{COOLING_S:g}s].force", "N"))
        yield weighted(
            observations,
            self.name,
            "a thermal state, electrodes alike, in ln Z",
            "log_impedance",
            drivers,
            fitting=ELECTRODES_ALIKE,
            weight_units=(*("ln Z per s",) * (len(drivers) - 1), "ln Z per N"),
        )

    def _by_contact(self, observations: Observations) -> Iterable[Candidate]:
        """The skin is warmed where it is touched, and cools in the air; tdc is measured in the core."""
        unit = "ln Z" if observations.raw_counts else "counts"
        longest_s: dict[Starts, float] = {"settled": observations.usual_segment_s}
        if observations.starts_pressed:
            longest_s["rest"] = SLOWER_FROM_REST * observations.usual_segment_s
        for warming, cooling, start in product(RATES_S, RATES_S, longest_s):
            if max(warming, cooling) > longest_s[start]:
                continue
            rest = ", from rest" if start == "rest" else ""
            warmth = Warmth(of="force", warming_s=warming, cooling_s=cooling, starts=start)
            yield weighted(
                observations,
                self.name,
                f"contact warms in {warming:g} s, air cools in {cooling:g} s{rest}, in {unit}",
                "log_impedance" if observations.raw_counts else "unit",
                [past(observations, warmth, f"warmth[{warming:g}s,{cooling:g}s{rest}].force", "1")],
                fitting=ELECTRODES_ALIKE,
                form_parameters={WARMING: (warming, "s"), "cooling": (cooling, "s")},
                weight_names=("slope",),
                weight_units=(unit,),
            )
