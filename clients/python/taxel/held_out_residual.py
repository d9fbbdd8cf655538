"""A model's own held-out residual, as its manifest keeps it: what the loop judges other recordings by."""

from collections.abc import Mapping
from typing import Annotated, Final

from pydantic import Field

from taxel.channels import CHANNELS
from taxel.schema import NotNegativePerChannel, PerChannel, Schema

AGEING: Final = ", ageing"
"""Ends an effect's name where also its forms that grow or fade over a session count."""

ALIKE: Final = ", alike"
"""Ends an effect's name where only its forms count whose weights channels share."""


class OwnStructure(Schema):
    """What one effect explains of a model's own held-out residual.

    Attributes:
        log_evidence: logarithm of each channel's odds with the effect to those without it, for each bin of
            rows.
        gain: what it takes off each channel's squared error, counts².
        forms: of an effect whose forms change every recording alike, those that may explain so much; none
            where any may, and in a manifest of an earlier version.
    """

    log_evidence: NotNegativePerChannel
    gain: NotNegativePerChannel
    forms: tuple[str, ...] = ()

    def has(self, form: str) -> bool:
        """Whether a form may explain so much."""
        return not self.forms or form in self.forms


def known_as(name: str, structure: Mapping[str, OwnStructure]) -> str | None:
    """The name under which a structure has an effect's forms, or the nearest forms that it knows.

    Args:
        name: of the effect, with `AGEING` and `ALIKE` where they apply.
    """
    names = (name, name.removesuffix(ALIKE), name.replace(AGEING, ""))
    return next((one for one in (*names, names[-1].removesuffix(ALIKE)) if one in structure), None)


class OwnWave(Schema):
    """A wave of constant frequency in a model's own held-out residual, such as a material's texture gives.

    Attributes:
        frequency_hz: of the wave.
        energy: what it explains of each channel's squared error, counts².
    """

    frequency_hz: Annotated[float, Field(gt=0)]
    energy: NotNegativePerChannel


class KnownKind(Schema):
    """What a recording of one kind may show, of which training held some out.

    Attributes:
        std: root of the mean square of each channel's residual on it, counts.
        structure: what each effect explains of it.
        correlated: likewise, what the channels show beside each other.
        waves: of its residual; none in a manifest of an earlier version.
    """

    std: NotNegativePerChannel
    structure: dict[str, OwnStructure] = Field(default_factory=dict)
    correlated: dict[str, OwnStructure] = Field(default_factory=dict)
    waves: tuple[OwnWave, ...] = ()


class KindResidual(Schema):
    """A model's residual on one kind alone, such as one of several materials.

    Attributes:
        std: root of the mean square of each channel's residual, counts.
        structure: what each effect explains of it: mean over the kinds, and two standard deviations more.
        herfindahl: sum of the squared shares of the rows that each kind has in all recordings together.
        correlated: likewise, what the channels show beside each other; none in a manifest of an earlier
            version.
        kinds: those that are known by themselves, by their values such as `7`; likewise.
    """

    std: NotNegativePerChannel
    structure: dict[str, OwnStructure]
    herfindahl: Annotated[float, Field(gt=0, lt=1)]
    correlated: dict[str, OwnStructure] = Field(default_factory=dict)
    kinds: dict[str, KnownKind] = Field(default_factory=dict)


class CorrelatedResidual(Schema):
    """How the errors of the channels go along with each other.

    Attributes:
        precision: (21, 21) inverse of their covariance, counts⁻².
        shared: the part of each whitened channel's variance that a whole contact shares.
        fading: the part that fades within seconds.
        structure: by effect, what a change of each channel alone explains, with its gain over the noise; of
            effects that change many channels, the odds of each whitened channel.
    """

    precision: Annotated[tuple[PerChannel, ...], Field(min_length=len(CHANNELS), max_length=len(CHANNELS))]
    shared: NotNegativePerChannel
    fading: NotNegativePerChannel
    structure: dict[str, OwnStructure] = Field(default_factory=dict)


class HeldOutResidual(Schema):
    """A model's residual on the recordings that its training held out: what it gets wrong anyway.

    Attributes:
        rows: how many rows it is from.
        std: root of the mean square of each channel's residual, counts.
        shared: the part of each channel's variance that a whole contact shares.
        fading: the part that fades within seconds.
        structure: what each effect explains of it. An effect's name means its forms that do not age, with
            `AGEING` also the others, with `ALIKE` at the end only those whose weights channels share. An
            effect of one sort of forms, and a manifest of an earlier version, has its name alone.
        one_kind: what a recording of one kind alone shows, by the column that names kinds.
        sensitivity_change: the factor by which each channel's sensitivity seems to change in the course of
            it; none in a manifest of an earlier version.
        correlated: how the errors of its channels go along with each other; likewise.
        new_kinds: by column, what kinds would show that training never had; none where too few are known.
        waves: of all recordings together; likewise.
    """

    rows: Annotated[int, Field(gt=0)]
    std: NotNegativePerChannel
    shared: NotNegativePerChannel
    fading: NotNegativePerChannel
    structure: dict[str, OwnStructure] = Field(default_factory=dict)
    one_kind: dict[str, KindResidual] = Field(default_factory=dict)
    sensitivity_change: NotNegativePerChannel | None = None
    correlated: CorrelatedResidual | None = None
    new_kinds: dict[str, "HeldOutResidual"] = Field(default_factory=dict)
    waves: tuple[OwnWave, ...] = ()
