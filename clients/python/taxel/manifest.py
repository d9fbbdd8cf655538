"""The manifest of an artifact: `manifest.json`, checked whenever it is read."""

from typing import Annotated, Any, Final, Literal, Self

from pydantic import Field, FiniteFloat, StringConstraints, model_validator

from taxel.channels import CHANNELS
from taxel.corrections import AppliedEffect
from taxel.errors import InvalidArgument
from taxel.held_out_residual import HeldOutResidual
from taxel.schema import Positive, Schema
from taxel.trained_contacts import TrainedContacts
from taxel.windows import PERIOD_NS, ExtraFeature, WindowSpec

SCHEMA: Final = 1

MOST_FEATURES: Final = 1024
"""The most features of a window. The largest input combination has 72."""

MOST_EFFECTS: Final = 64
MOST_EXTRAS: Final = 256

INPUT_NAME: Final = "window"
OUTPUT_NAME: Final = "channels"
SPREAD_NAME: Final = "spread"
"""An ensemble's second output: the standard deviation of its members, counts."""

Platform = Literal["xgboost_json", "onnxruntime_onnx"]
Name = Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,63}$")]
Version = Annotated[str, StringConstraints(pattern=r"^[1-9][0-9]{0,8}$")]
Sha256 = Annotated[str, StringConstraints(pattern=r"^[0-9a-f]{64}$")]


class Tensor(Schema):
    """A tensor as the Open Inference Protocol describes it; -1 is the batch axis."""

    name: str
    datatype: Literal["FP32"] = "FP32"
    shape: tuple[Literal[-1], Annotated[int, Field(gt=0, le=MOST_FEATURES)]]


class WindowLayout(Schema):
    """The window that a model was trained on, with every feature by name.

    `features` has the name of every column in order: first the input combination's, then the extras of the
    model file, then the extras that only the effects take. The window's middle lies `shift` ticks
    before T.
    """

    combination: int
    sample_period_ms: float = PERIOD_NS / 1e6
    features: Annotated[tuple[str, ...], Field(max_length=MOST_FEATURES)]
    extras: Annotated[tuple[ExtraFeature, ...], Field(max_length=MOST_EXTRAS)] = ()
    look_ahead: int
    shift: int = 0

    @classmethod
    def of(cls, spec: WindowSpec, extras: tuple[ExtraFeature, ...] = ()) -> Self:
        """The layout of an input combination."""
        names = tuple(extra.name for extra in extras)
        return cls(
            combination=spec.combination,
            features=spec.features + names,
            extras=extras,
            look_ahead=spec.look_ahead,
            shift=spec.shift,
        )

    @property
    def spec(self) -> WindowSpec:
        """The window to build, without extras."""
        return WindowSpec.of(self.combination, self.shift)

    @property
    def model_extras(self) -> tuple[ExtraFeature, ...]:
        """The extras that the model file takes."""
        return tuple(extra for extra in self.extras if extra.taken_by == "model")

    @property
    def effect_extras(self) -> tuple[ExtraFeature, ...]:
        """The extras that only the effects take."""
        return tuple(extra for extra in self.extras if extra.taken_by == "effects")

    @property
    def model_columns(self) -> int:
        """How many features the model file takes: the first ones."""
        return len(self.features) - len(self.effect_extras)

    @model_validator(mode="after")
    def _agrees_with_the_builder(self) -> Self:
        try:
            spec = self.spec
        except InvalidArgument as error:
            raise ValueError(str(error)) from None
        names = tuple(extra.name for extra in self.extras)
        # Effects call the window's features by their unshifted names.
        taken = {*spec.features, *spec.unshifted.features}
        if len(taken.union(names)) < len(taken) + len(names):
            raise ValueError(f"extras {list(names)}: expected names that no other feature has")
        built = spec.features + names
        if self.features != built:
            raise ValueError(f"features {list(self.features)} are not those built: {list(built)}")
        if self.look_ahead != spec.look_ahead:
            raise ValueError(f"look_ahead {self.look_ahead}: expected {spec.look_ahead} ticks")
        if self.sample_period_ms != PERIOD_NS / 1e6:
            raise ValueError(f"sample_period_ms {self.sample_period_ms}: expected {PERIOD_NS / 1e6}")
        if self.extras != self.model_extras + self.effect_extras:
            raise ValueError("extras: expected those that the model takes before those of the effects")
        return self


class Normalisation(Schema):
    """Means and standard deviations of the model file's inputs and outputs, over the training set.

    If `folded` is true, the model file takes raw windows and gives counts. Otherwise the runtime
    normalises before and after.
    """

    input_mean: tuple[FiniteFloat, ...]
    input_std: tuple[Positive, ...]
    output_mean: tuple[FiniteFloat, ...]
    output_std: tuple[Positive, ...]
    folded: bool = False


class RecordingFingerprint(Schema):
    """Which recording a model was trained on, or a study was run on."""

    name: str
    format: str
    rows: int
    sha256: Sha256


class Training(Schema):
    """How a model was trained: enough to train it again, and on which contacts.

    `contacts` is of the training set; a model of Taxel 0.2 or earlier has none.
    """

    family: str
    data: tuple[RecordingFingerprint, ...]
    windows: dict[str, int]
    split: dict[str, Any]
    seed: int
    hyperparameters: dict[str, Any]
    metrics: dict[str, Any]
    contacts: TrainedContacts | None = None

    @property
    def held_out_norm_mae(self) -> float | None:
        """The normalised MAE of the test set; None if it was not measured."""
        found = self.metrics.get("test")
        error = found.get("norm_mae") if isinstance(found, dict) else None
        return float(error) if isinstance(error, (int, float)) else None


class Imported(Schema):
    """The file of another program that a model was made from. How it was trained is not known."""

    format: str
    file: str
    sha256: Sha256


class Parity(Schema):
    """The largest difference between the artifact's predictions and those of its source, in counts."""

    windows: int
    largest_difference: FiniteFloat
    tolerance: Positive


class RoundedWeights(Schema):
    """The errors on held-out windows with rounded weights and with the original weights.

    Attributes:
        datatype: datatype of most weights in the model file.
        windows: how many were compared.
        norm_mae: normalised mean absolute error of the artifact.
        float32_norm_mae: that of the trained model.
        float32_size: bytes of the model file with weights as trained.
    """

    datatype: Literal["INT8"]
    windows: Annotated[int, Field(gt=0)]
    norm_mae: Positive
    float32_norm_mae: Positive
    float32_size: Annotated[int, Field(gt=0)]

    @property
    def rise(self) -> float:
        """The relative rise of the error through rounding."""
        return self.norm_mae / self.float32_norm_mae - 1


class ModelFile(Schema):
    """The model's bytes."""

    name: Annotated[str, StringConstraints(pattern=r"^model\.(onnx|json)$")]
    sha256: Sha256
    size: Annotated[int, Field(gt=0)]


class Manifest(Schema):
    """Everything about an artifact except its weights.

    Either `training` says how it was trained, or `imported` names the file that it was made from.

    Raises:
        pydantic.ValidationError: any part is missing, unknown or at odds with another.
    """

    schema_version: Literal[1] = SCHEMA
    name: Name
    version: Version
    description: str
    platform: Platform
    inputs: tuple[Tensor]
    outputs: tuple[Tensor] | tuple[Tensor, Tensor]
    window: WindowLayout
    channels: tuple[str, ...] = CHANNELS
    normalisation: Normalisation
    effects: Annotated[tuple[AppliedEffect, ...], Field(max_length=MOST_EFFECTS)] = ()
    parameters: int
    training: Training | None
    imported: Imported | None = None
    parity: Parity | None = None
    rounded_weights: RoundedWeights | None = None
    held_out_residual: HeldOutResidual | None = None
    model_file: ModelFile
    taxel_version: str

    @property
    def label(self) -> str:
        """Name and version, for messages."""
        return f"{self.name}/{self.version}"

    @property
    def trained_contacts(self) -> TrainedContacts | None:
        """The contacts that the model was trained on; None where they are not known."""
        return None if self.training is None else self.training.contacts

    @property
    def gives_spread(self) -> bool:
        """Whether it has a second output with the spread of its members."""
        return len(self.outputs) > 1

    @property
    def spec(self) -> WindowSpec:
        """The window to build for this model."""
        return self.window.spec

    @property
    def base(self) -> "Manifest":
        """The model file without effects: it takes unshifted windows and the file's own extras."""
        layout = WindowLayout.of(self.spec.unshifted, self.window.model_extras)
        return self.with_window(layout, effects=())

    def with_window(self, layout: WindowLayout, **changes: object) -> "Manifest":
        """The manifest with another window and other changes, checked like one that is read.

        Raises:
            ValidationError: the parts do not fit together.
        """
        inputs, outputs = tensors(layout, spread=self.gives_spread)
        fields = {field: getattr(self, field) for field in Manifest.model_fields}
        window = {"window": layout, "inputs": inputs, "outputs": outputs}
        return Manifest.model_validate({**fields, **window, **changes})

    @property
    def typical_window(self) -> tuple[float, ...]:
        """A window of all features: the means that the model was trained on, and the effects' defaults."""
        defaults = tuple(extra.default for extra in self.window.effect_extras)
        return self.normalisation.input_mean + defaults

    @model_validator(mode="after")
    def _effects_have_what_they_take(self) -> Self:
        window = self.window
        extras = {extra.name for extra in window.extras}
        known = extras.union(window.spec.unshifted.features)
        for effect in self.effects:
            if missing := effect.takes - known:
                raise ValueError(
                    f"effect {effect.name} takes {sorted(missing)}, which no feature is called"
                )
        taken = {name for effect in self.effects for name in effect.takes}
        if idle := {extra.name for extra in window.effect_extras} - taken:
            raise ValueError(f"extras {sorted(idle)}: no effect takes them")
        shift = sum(effect.shift_ticks for effect in self.effects)
        if window.shift != shift:
            raise ValueError(f"window.shift {window.shift}: expected {shift}, what the effects come to")
        return self

    @model_validator(mode="after")
    def _is_consistent(self) -> Self:
        features, channels = len(self.window.features), len(CHANNELS)
        if self.channels != CHANNELS:
            raise ValueError(f"channels {list(self.channels)}: expected {list(CHANNELS)}")
        described = [("inputs[0]", self.inputs[0], INPUT_NAME, features)]
        for number, (tensor, name) in enumerate(
            zip(self.outputs, (OUTPUT_NAME, SPREAD_NAME), strict=False)
        ):
            described.append((f"outputs[{number}]", tensor, name, channels))
        for where, tensor, name, length in described:
            if tensor.name != name or tensor.shape[1] != length:
                raise ValueError(f"{where} is {tensor.name} {tensor.shape}: expected {name} (-1, {length})")
        for field, length in (
            ("input_mean", self.window.model_columns),
            ("input_std", self.window.model_columns),
            ("output_mean", channels),
            ("output_std", channels),
        ):
            values = getattr(self.normalisation, field)
            if len(values) != length:
                raise ValueError(f"normalisation.{field} has {len(values)} values: expected {length}")
        if (self.training is None) == (self.imported is None):
            raise ValueError("expected either training or imported to be given")
        suffix = "json" if self.platform == "xgboost_json" else "onnx"
        if self.model_file.name != f"model.{suffix}":
            raise ValueError(
                f"model_file.name {self.model_file.name}: {self.platform} needs model.{suffix}"
            )
        return self


def tensors(
    layout: WindowLayout, *, spread: bool = False
) -> tuple[tuple[Tensor], tuple[Tensor] | tuple[Tensor, Tensor]]:
    """The inputs and outputs of a model that takes these windows, and maybe gives a spread."""
    channels = Tensor(name=OUTPUT_NAME, shape=(-1, len(CHANNELS)))
    outputs = (channels, channels.model_copy(update={"name": SPREAD_NAME})) if spread else (channels,)
    return (Tensor(name=INPUT_NAME, shape=(-1, len(layout.features))),), outputs
