"""What the loop found, as `report.json` holds it and `taxel loop --json` prints it."""

from typing import Any, Final

from pydantic import Field

from taxel.corrections import Parameter
from taxel.schema import Schema
from taxel_models.twin.protocol import RecordingProtocol

SCHEMA: Final = 1


class FoundEffect(Schema):
    """An effect that was named.

    Attributes:
        name: such as `creep` or `covariate:material`.
        form: which form of it, in words.
        equation: what it adds to a channel.
        channels: those that it changes.
        explained: share of the residual's energy on the evaluation part that goes when it is added to
            those before it, mean over the channels, noise included.
        conditional: share of the fit part's that comes back when it alone is taken out again.
        p_value: one-sided p of the corrected resampled t-test over the held-out folds, beside a constant of
            each channel.
        t_test: the same, as readers of earlier reports know it.
        log_evidence: natural logarithm of the odds with the effect to those without it, over all its forms,
            less what the model's own held-out residual gives it.
        parameters: what was fitted.
        confounded_with: effects that explain at least two thirds as much in its place on held-out folds,
            and have two thirds of its evidence.
        needs: features that it takes while serving, beside the window.
        served: whether the corrected model adds it; a fault that comes and goes is only reported.
    """

    name: str
    form: str
    equation: str
    channels: tuple[str, ...]
    explained: float
    conditional: float
    p_value: float
    t_test: float = Field(default_factory=lambda found: found["p_value"])
    log_evidence: float = 0.0
    parameters: tuple[Parameter, ...]
    confounded_with: tuple[str, ...]
    needs: tuple[str, ...]
    served: bool


class RejectedEffect(Schema):
    """A candidate that was not named.

    Attributes:
        form: the likeliest; empty where the recordings cannot show it.
        alone: share of the first residual's energy that its likeliest form explains by itself on held-out
            folds, less what it explains of the model's own held-out residual.
        left: likewise, when all others were named.
        p_value: as of a named one, when all others were named.
        log_evidence: likewise.
        reason: why it was not named, in words.
    """

    name: str
    form: str
    alone: float
    left: float
    p_value: float
    log_evidence: float = 0.0
    reason: str


class PairedTest(Schema):
    """Whether the error fell, block by block of the evaluation part.

    Attributes:
        blocks: compared.
        difference: mean fall of the normalised MAE, positive where it fell.
        low: of its 95 % interval.
        high: of its 95 % interval.
        t: of the paired t-test over blocks.
        p_value: one-sided.
    """

    method: str = "paired t-test over evaluation blocks, one-sided"
    blocks: int
    difference: float
    low: float
    high: float
    t: float
    p_value: float


class Unexplained(Schema):
    """What is left on the evaluation part.

    Attributes:
        structured: whether it is more than the channels' noise.
        hint: where to look next, in words.
        share: of what is left that noise cannot account for.
        autocorrelation: of what is left, mean over the channels, at one tick and at a second.
    """

    structured: bool
    hint: str
    share: float
    autocorrelation: dict[str, float]


class ChannelGain(Schema):
    """What a residual model brings to a channel.

    Attributes:
        channel: its name.
        folds: fall of its normalised MAE on held-out folds of the fit part, by which it was accepted.
        error: standard error of that over blocks.
        evaluation: fall of its normalised MAE on the evaluation part, which nothing was fitted to.
    """

    channel: str
    folds: float
    error: float
    evaluation: float


class FoundResidualModel(Schema):
    """A model of what no effect explains. It has no name and says nothing of causes.

    Attributes:
        about: what it is, in words.
        channels: those that have it, with its gain on held-out blocks.
        gain: fall of the normalised MAE on the evaluation part, mean over all 21 channels.
        needs: features that it takes while serving, beside the window.
    """

    about: str
    channels: tuple[ChannelGain, ...]
    gain: float
    needs: tuple[str, ...]


class RunsAlong(Schema):
    """How much one quantity runs along with another in the recordings, whatever the residual is.

    Attributes:
        quantity: such as `place`.
        along: such as `time` or `material`.
        share: of the quantity's variance that the other one predicts, less what chance gives.
    """

    quantity: str
    along: str
    share: float


class NextRecording(Schema):
    """What to record to tell two causes apart.

    Attributes:
        causes: the named one and the one that it cannot be told from.
        protocol: what to do; None if the loop would decide rightly in fewer than eight of ten recordings of
            every protocol of the menu, or the causes cannot be simulated.
        file: the protocol's file in the report's folder; empty if there is none.
        duration_s: how long it takes.
        simulated: recordings of it that were simulated, half of them with each cause.
        right: how many of these the loop decided rightly.
        can_be_simulated: whether both causes say what they would do in other recordings.
    """

    causes: tuple[str, str]
    protocol: RecordingProtocol | None = None
    file: str = ""
    duration_s: float = 0.0
    simulated: int = 0
    right: int = 0
    can_be_simulated: bool = True


class Autocorrelation(Schema):
    """Of the residual on the evaluation part, inside segments.

    Attributes:
        lags_s: m lags, s.
        band: (m,) so far from 0 lie 99 % of the values of white noise.
        before: of each channel's first residual, (m,).
        after: of what is left of it, (m,).
    """

    lags_s: tuple[float, ...]
    band: tuple[float, ...]
    before: dict[str, tuple[float, ...]]
    after: dict[str, tuple[float, ...]]


class CrossCorrelation(Schema):
    """Of the residual with an input so many seconds earlier, on the evaluation part, inside segments.

    Attributes:
        input: its name.
        lags_s: m lags, s.
        before: of each channel's first residual, (m,).
        after: of what is left of it, (m,).
        band_before: for each channel, so far from 0 lie 99 % of the values of a residual that does not
            depend on the input. Rows of a block may be correlated; blocks are taken as independent.
        band_after: likewise.
    """

    input: str
    lags_s: tuple[float, ...]
    before: dict[str, tuple[float, ...]]
    after: dict[str, tuple[float, ...]]
    band_before: dict[str, float]
    band_after: dict[str, float]


class ParameterCorrelation(Schema):
    """Correlations between the weights of all named effects, as the fit part determines them.

    Attributes:
        parameters: k names, each of an effect and a weight.
        matrix: (k, k), each value of the channel in which it is largest, signed. Near 1 or -1, the
            recording tells only a sum or a difference of the two.
    """

    parameters: tuple[str, ...]
    matrix: tuple[tuple[float, ...], ...]


class Stability(Schema):
    """How often effects are named on random halves of the fit part's blocks.

    Attributes:
        halves: how many; each half is used with the other half (Shah and Samworth 2013).
        chosen: the share of the halves on which each effect was named, the most frequent first.
    """

    halves: int
    chosen: dict[str, float]


class NewKinds(Schema):
    """Values of a column, such as materials, that the model was not trained on.

    Attributes:
        column: its name.
        values: in order.
        share: of the rows that have one of them.
    """

    column: str
    values: tuple[float, ...]
    share: float


class Findings(Schema):
    """Everything the loop found.

    Attributes:
        model: name and version.
        data: one entry a recording: name, format, rows, sha256.
        split: how blocks were cut and held out.
        noise_floor: the error that no effect could take away.
        effects: in the order in which they were named; a fault behind those that explain more.
        before: errors of the model on the evaluation part, as `taxel predict` reports them.
        after: errors of the corrected model there, by the forms that are served.
        error_ratio: for each channel, RMS residual of the model on the evaluation part over that of what
            its training held out; empty where its manifest does not tell it.
        looks_wrong: in the recordings, as `taxel recording` tells it; none in an earlier version.
        changes: a sentence for each channel whose sensitivity, or else whose reading, changed.
        one_kind: columns with one value here, of which the model's own held-out residual had several.
        new_kinds: what the model was not trained on, as far as its manifest tells.
        residual_model: what predicts a part of what remains, if it was asked for and proved itself.
        confounding: what runs along with what in the recordings, the largest share first; empty for
            fewer than eight contacts.
        next_recordings: for each pair of causes that cannot be told apart, what to record.
        autocorrelation: of the residual before and after.
        cross_correlation: of the residual with each input, before and after.
        parameter_correlation: between fitted weights; None if fewer than two were fitted.
        stability: on random halves of the blocks; None if that was not asked for.
        exported: the version that was written, or None.
    """

    schema_version: int = SCHEMA
    model: str
    data: tuple[dict[str, Any], ...]
    split: dict[str, Any]
    noise_floor: dict[str, Any]
    effects: tuple[FoundEffect, ...]
    rejected: tuple[RejectedEffect, ...]
    before: dict[str, Any]
    after: dict[str, Any]
    test: PairedTest
    unexplained: Unexplained
    error_ratio: dict[str, float] = Field(default_factory=dict)
    looks_wrong: tuple[str, ...] = ()
    changes: tuple[str, ...] = ()
    one_kind: tuple[str, ...] = ()
    new_kinds: tuple[NewKinds, ...] = ()
    residual_model: FoundResidualModel | None = None
    confounding: tuple[RunsAlong, ...] = ()
    next_recordings: tuple[NextRecording, ...] = ()
    autocorrelation: Autocorrelation | None = None
    cross_correlation: tuple[CrossCorrelation, ...] = ()
    parameter_correlation: ParameterCorrelation | None = None
    stability: Stability | None = None
    exported: str | None = None

    @property
    def raises_the_error(self) -> bool:
        """Whether the corrected model is off by more on blocks that nothing was fitted to."""
        return bool(self.after["norm_mae"] > self.before["norm_mae"])
