"""Temperature: it changes the fluid's conductivity, and so the impedance of every electrode."""

from collections.abc import Iterable
from itertools import product
from typing import Final

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from taxel.channels import CHANNELS, ELECTRODE_COLUMNS
from taxel.windows import Relaxation, Warmth
from taxel_models.loop.effects.drift import PIECES, SHORTEST_S
from taxel_models.loop.effects.effect import (
    Candidate,
    Effect,
    Fitting,
    Remaining,
    elapsed,
    evenly_filled,
    given,
    past,
    weighted,
)
from taxel_models.loop.observations import Observations

TDC: Final = "tdc"
COOLING_S: Final = 8.0
"""How long a contact takes to cool the core. The seconds are the twin's assumption."""

RATES_S: Final = (3.0, 10.0, 30.0, 100.0)
"""Time constants that contact may warm and air may cool the skin with, half a decade apart."""

ALIKE: Final = 0.35
"""The largest SD over mean of the electrodes' slopes: they share the fluid. On LASA's idle finger, ln Z of
all electrodes fell by 21 to 24 %."""

LEAST_COUNTS: Final = 2.0
"""A smaller standard deviation of tdc is its own noise."""


class Temperature(Effect):
    """A shift of ln Z, proportional to the measured temperature. Tared channels have a shift of counts."""

    name = "temperature"
    equation = (
        "ln Z_c = ln Z_c(model) + k_c (tdc - mean), or k_c warmth; delta_c = dE/dlnZ k_c (tdc - mean)"
    )
    source = "LASA's idle finger: warming lowers ln Z of all electrodes alike; -2 %/K (unverified)"
    signature = "the residual follows tdc or past touches, common to all electrodes in ln Z"

    @override
    def forms(self, observations: Observations, remaining: Remaining) -> Iterable[Candidate]:
        values = observations.covariates.get(TDC)
        if values is None:
            yield from self._by_state(observations)
            return
        if values.std() < LEAST_COUNTS:
            return
        driver = given(observations, TDC, "counts")
        if observations.raw_counts:
            electrodes = _electrodes()
            yield weighted(
                observations,
                self.name,
                "electrodes alike, in ln Z",
                "log_impedance",
                [driver],
                fitting=Fitting(pooled=True, allowed=electrodes),
                weight_names=("slope",),
                weight_unit="ln Z per tdc count",
            )
            yield weighted(
                observations,
                self.name,
                "by channel, in ln Z",
                "log_impedance",
                [driver],
                weight_names=("slope",),
                weight_unit="ln Z per tdc count; counts per tdc count for pac0 and pdc",
                alike=ALIKE,
            )
            yield from self._by_contact(observations)
        else:
            yield weighted(
                observations,
                self.name,
                "by channel",
                "unit",
                [driver],
                weight_names=("slope",),
                weight_unit="counts per tdc count",
            )

    def _by_state(self, observations: Observations) -> Iterable[Candidate]:
        """Without a measured temperature: the finger warms up after the start; contact cools it."""
        span = float(observations.time_s.max())
        if span < SHORTEST_S or not observations.raw_counts:
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
            fitting=Fitting(pooled=True, allowed=_electrodes()),
            weight_unit="ln Z per s; ln Z per N",
        )
        yield from self._by_contact(observations)

    def _by_contact(self, observations: Observations) -> Iterable[Candidate]:
        """The skin is warmed where it is touched, and cools in the air; tdc is measured in the core."""
        for warming, cooling in product(RATES_S, RATES_S):
            if max(warming, cooling) > observations.usual_segment_s:
                continue
            warmth = Warmth(of="force", warming_s=warming, cooling_s=cooling)
            yield weighted(
                observations,
                self.name,
                f"contact warms in {warming:g} s, air cools in {cooling:g} s, in ln Z",
                "log_impedance",
                [past(observations, warmth, f"warmth[{warming:g}s,{cooling:g}s].force", "1")],
                fitting=Fitting(pooled=True, allowed=_electrodes()),
                form_parameters={"warming": (warming, "s"), "cooling": (cooling, "s")},
                weight_names=("slope",),
                weight_unit="ln Z",
            )


def _electrodes() -> NDArray[np.bool_]:
    electrodes = np.zeros(len(CHANNELS), bool)
    electrodes[ELECTRODE_COLUMNS] = True
    return electrodes
