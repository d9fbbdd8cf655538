"""Rate: a channel answers to the speed of the force or of the motion."""

from collections.abc import Iterable

from typing_extensions import override

from taxel.channels import CHANNELS
from taxel.windows import Speed, history
from taxel_models.loop.effects.effect import Candidate, Effect, Left, past, weighted
from taxel_models.loop.evidence import Evidence
from taxel_models.loop.planting import Planting


class Rate(Effect):
    """A viscous part: in proportion to dF/dt, or to the contact's speed."""

    name = "rate"
    equation = "delta_c = sum_u w_cu du/dt, u of |F|, Fx, Fy, Fz; or w_c |dx/dt|"
    source = "Kelvin-Voigt element; differences over 30 ms, 100 ms for the speed"
    signature = "the residual is there only while force or place change, with the sign of the change"

    @override
    def forms(self, evidence: Evidence, left: Left) -> Iterable[Candidate]:
        rates = [
            past(evidence, history.Rate(of=of), f"rate.{of}", "N/s") for of in ("force", "fx", "fy", "fz")
        ]
        speed = past(evidence, Speed(), "speed", "m/s")
        forms = (
            ("of force", rates[:1], "counts s/N"),
            ("of force and its direction", rates, "counts s/N"),
            ("speed", [speed], "counts s/m"),
        )
        for form, drivers, unit in forms:
            yield weighted(evidence, self.name, form, "unit", drivers, weight_unit=unit)

    @override
    def plant(self, planting: Planting) -> None:
        rate = planting.history(history.Rate(of="force"))
        weights = planting.random.normal(0.0, 1.0, len(CHANNELS)) * planting.residual
        planting.add(rate[:, None] * weights, {"weight": weights})
