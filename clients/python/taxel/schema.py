"""The base class and the field types of everything in a manifest."""

from typing import Annotated, Final

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, FiniteFloat

from taxel.channels import CHANNELS

MOST_TEXT: Final = 10_000
"""The most characters of one text; the longest text of a shipped manifest has some hundred."""


class Schema(BaseModel):
    """The base of a manifest's parts. They are frozen and refuse unknown fields and endless texts."""

    model_config = ConfigDict(extra="forbid", frozen=True, str_max_length=MOST_TEXT)


def _channel(name: str) -> str:
    if name not in CHANNELS:
        raise ValueError(f"no channel {name!r}: expected one of {', '.join(CHANNELS)}")
    return name


ChannelName = Annotated[str, AfterValidator(_channel)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
_ALL = Field(min_length=len(CHANNELS), max_length=len(CHANNELS))
PerChannel = Annotated[tuple[FiniteFloat, ...], _ALL]
"""One number for each channel, in the order of `CHANNELS`."""

NotNegativePerChannel = Annotated[tuple[NotNegative, ...], _ALL]

Vector = tuple[FiniteFloat, FiniteFloat, FiniteFloat]
Matrix = tuple[Vector, Vector, Vector]
"""Three rows."""
