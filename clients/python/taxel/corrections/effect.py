"""An effect as a manifest holds it: what it is called, its parameters, and how it is computed."""

from collections.abc import Mapping
from typing import Annotated, Any, Final

from pydantic import BeforeValidator, Field, FiniteFloat

from taxel.corrections.calibrated import Calibrated
from taxel.corrections.count_limits import CountLimits
from taxel.corrections.crosstalk import Crosstalk
from taxel.corrections.fault import Fault
from taxel.corrections.frame import Frame
from taxel.corrections.location import Location
from taxel.corrections.random_features import RandomFeatures
from taxel.corrections.saturation import Saturation
from taxel.corrections.weighted import Weighted
from taxel.schema import ChannelName, Schema
from taxel.windows.combinations import MOST_SHIFT

_FORMER_KINDS: Final = {
    "places": "location",
    "mix": "crosstalk",
    "limit": "saturation",
    "substitute": "fault",
}
"""What Taxel 0.1 wrote into manifests, and the kind of today."""


def _with_present_kind(fields: Any) -> Any:
    if isinstance(fields, Mapping) and fields.get("kind") in _FORMER_KINDS:
        return {**fields, "kind": _FORMER_KINDS[fields["kind"]]}
    return fields


Term = Annotated[
    Weighted | Calibrated | Location | Crosstalk | Saturation | RandomFeatures | CountLimits | Fault,
    Field(discriminator="kind"),
    BeforeValidator(_with_present_kind),
]
"""Any of the terms, told apart by `kind`. The kinds of 0.1 are read, too; only today's are written."""


class Parameter(Schema):
    """A fitted parameter with its interval, where there is one."""

    name: str
    value: FiniteFloat
    unit: str
    low: FiniteFloat | None = None
    high: FiniteFloat | None = None


class AppliedEffect(Schema):
    """An effect that a base model lacks and that a corrected model adds to it.

    Attributes:
        name: such as `creep` or `covariate:material`.
        about: one sentence.
        channels: those that it changes.
        parameters: what was fitted, for people; the terms hold what is computed with.
        frame: how windows are turned before the base model sees them.
        shift_ticks: by how much the middle of the window lies before T; above 0 where the
            channels trail the contact.
        terms: what is added to the prediction.
    """

    name: Annotated[str, Field(min_length=1)]
    about: str
    channels: tuple[ChannelName, ...]
    parameters: tuple[Parameter, ...] = ()
    frame: Frame | None = None
    shift_ticks: Annotated[int, Field(ge=-MOST_SHIFT, le=MOST_SHIFT)] = 0
    terms: tuple[Term, ...] = ()

    @property
    def takes(self) -> frozenset[str]:
        """The features that its terms need."""
        return frozenset(name for term in self.terms for name in term.takes)
