"""Rate: a channel responds to the speed of the force or of the motion."""

from collections.abc import Iterable
from typing import Final

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from taxel.windows import BoundedRate, Relaxation, Speed, history
from taxel_models.loop.effects.drivers import past, weighted
from taxel_models.loop.effects.effect import Candidate, Effect, Remaining
from taxel_models.loop.observations import Observations

HALVES_N_S: Final = tuple(np.geomspace(0.5, 32.0, 7).tolist())
SMOOTHED_S: Final = (0.05, 0.1)
"""Time constants of the low-pass that a rate goes through; what relaxes more slowly is creep."""

FINER: Final = (0.71, 1.41)
"""Factors of finer figures; neighbours on the grid differ by a factor of 2."""


class Rate(Effect):
    """A viscous part: it is proportional to dF/dt or to the contact's speed, or grows less than dF/dt."""

    name = "rate"
    equation = (
        "delta_c = sum_u w_cu du/dt, u of |F|, Fx, Fy, Fz; w_c r / (half + |r|), r = d|F|/dt; "
        "w_c (L_T |F| - |F|), L_T a low-pass of at most 0.1 s; or w_c |dx/dt|"
    )
    source = (
        "Kelvin-Voigt element; a fluid that thins (Cross 1965); "
        "differences over 30 ms, 100 ms for the speed"
    )
    signature = "the residual is there only while force or place change, with the sign of the change"

    @override
    def forms(self, observations: Observations, remaining: Remaining) -> Iterable[Candidate]:
        rates = [
            past(observations, history.Rate(of=of), f"rate.{of}", "N/s")
            for of in ("force", "fx", "fy", "fz")
        ]
        speed = past(observations, Speed(), "speed", "m/s")
        forms = (
            ("of force", rates[:1], "counts s/N"),
            ("of force and its direction", rates, "counts s/N"),
            ("speed", [speed], "counts s/m"),
        )
        for form, drivers, unit in forms:
            yield weighted(observations, self.name, form, "unit", drivers, weight_units=(unit,))
        for half in HALVES_N_S:
            yield self._bounded(observations, half)
        for smoothed_s in SMOOTHED_S:
            yield self._smoothed(observations, smoothed_s)

    @override
    def finer(
        self, observations: Observations, best: Candidate, fit: NDArray[np.bool_]
    ) -> Iterable[Candidate]:
        if "half" in best.form_parameters:
            for factor in FINER:
                yield self._bounded(observations, best.form_parameters["half"][0] * factor)
        if "smoothed" in best.form_parameters:
            for factor in FINER:
                finer = best.form_parameters["smoothed"][0] * factor
                if finer <= max(SMOOTHED_S):
                    yield self._smoothed(observations, finer)

    def _smoothed(self, observations: Observations, smoothed_s: float) -> Candidate:
        feature = Relaxation(of="force", time_constant_s=smoothed_s)
        return weighted(
            observations,
            self.name,
            f"of force, over {1000 * smoothed_s:.0f} ms",
            "unit",
            [past(observations, feature, f"relaxation[{smoothed_s:.3g}s].force", "N")],
            form_parameters={"smoothed": (smoothed_s, "s")},
            weight_units=("counts/N",),
        )

    def _bounded(self, observations: Observations, half: float) -> Candidate:
        feature = BoundedRate(of="force", half_n_s=half)
        return weighted(
            observations,
            self.name,
            f"of force, half at {half:.3g} N/s",
            "unit",
            [past(observations, feature, f"rate[{half:.3g}N/s].force", "")],
            form_parameters={"half": (half, "N/s")},
            weight_units=("counts",),
        )
