"""Rate: a channel responds to the speed of the force or of the motion."""

from collections.abc import Iterable

from typing_extensions import override

from taxel.windows import Speed, history
from taxel_models.loop.effects.effect import Candidate, Effect, Remaining, past, weighted
from taxel_models.loop.observations import Observations


class Rate(Effect):
    """A viscous part: it is proportional to dF/dt or to the contact's speed."""

    name = "rate"
    equation = "delta_c = sum_u w_cu du/dt, u of |F|, Fx, Fy, Fz; or w_c |dx/dt|"
    source = "Kelvin-Voigt element; differences over 30 ms, 100 ms for the speed"
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
            yield weighted(observations, self.name, form, "unit", drivers, weight_unit=unit)
