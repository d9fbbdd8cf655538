"""Predictors and their sources. Local and remote ones have the same interface."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Final, Literal, NamedTuple, NoReturn, Self

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from taxel.arguments import checked_rate, is_whole
from taxel.errors import InvalidArgument
from taxel.fingers import Fingers
from taxel.input_checks import InputCheck
from taxel.manifest import Manifest, WindowLayout
from taxel.windows import WindowSpec, WindowStream
from taxel.windows.checks import check_windows
from taxel.windows.samples import period_of, rows_are_ticks

NOT_PICKLED: Final = (
    "a {} cannot be pickled or copied: it belongs to its process; send the endpoint or the repository's "
    "path, and the model's name, and open them there with taxel.connect or taxel.load"
)
"""Why a predictor or a source stays in its process."""


DEFAULT_MODEL: Final = "xgb-causal"
"""The model for who names none: it answers without delay, and it comes with Taxel."""


class Timing(NamedTuple):
    """How long the server took for a request.

    Attributes:
        queue_us: microseconds from the request's arrival until its evaluation began.
        compute_us: microseconds of its evaluation, together with the requests in the same batch.
        batch_rows: windows that were evaluated together.
    """

    queue_us: int
    compute_us: int
    batch_rows: int


@dataclass(frozen=True)
class ModelInfo:
    """One version of a model that a source offers.

    `state` is `READY`, or `UNAVAILABLE` with the `reason`. What evaluates it is known once it is loaded.

    Attributes:
        one_row: the evaluator of a single window.
        many_rows: the evaluator of 1024 windows.
        instruction_set: that the first of them uses; empty where a library does not tell.
        shadow: whether it answers only copies of requests, to be compared.
        delay_s: how long after its moment a live answer comes, s; 0 if causal.
        warm_up_s: from a stream's first sample to its first answer, s.
        norm_mae: the normalised MAE on what its training held out; not known of an imported model.
    """

    name: str
    version: str
    state: str
    reason: str
    platform: str
    combination: int | None
    one_row: str = ""
    many_rows: str = ""
    instruction_set: str = ""
    shadow: bool = False
    delay_s: float | None = None
    warm_up_s: float | None = None
    norm_mae: float | None = None

    @classmethod
    def read(cls, fields: dict[str, Any]) -> Self:
        """From a server's index. A newer server may tell more: fields that this version lacks are ignored.

        Raises:
            TypeError: a field is missing.
        """
        known = cls.__dataclass_fields__
        return cls(**{name: value for name, value in fields.items() if name in known})


class BasePredictor:
    """What every predictor knows of its model, whether its calls wait or are awaited.

    Attributes:
        manifest: everything about the model.
    """

    def __init__(self, manifest: Manifest) -> None:
        self.manifest = manifest
        self._features = manifest.window.features
        self._extras = manifest.window.extras

    @property
    def window(self) -> WindowSpec:
        """What one window holds, for `build_windows` and `WindowStream`."""
        return self.manifest.spec

    def checked(self, windows: NDArray[Any]) -> NDArray[np.float32]:
        """Windows as the model takes them: float32, C-contiguous, with its extra features.

        Extra features that are not given, the last ones, take their defaults.

        Raises:
            InvalidArgument: wrong shape or datatype, no rows, or a value that is not finite.
        """
        try:
            if self._extras:
                windows = _with_extras(np.asarray(windows), self.manifest.window)
            return check_windows(windows, self._features)
        except (TypeError, ValueError) as error:
            raise InvalidArgument(f"window: {error}: expected an array (n, f) of numbers") from None

    def stream(self, *, rate_hz: float = 100.0, fingers: int = 1, strict: bool = False) -> WindowStream:
        """A builder of this model's windows, extra features included, from live samples.

        It warns (`taxel.errors.InputWarning`) of samples that look wrong beside those of the training.

        Args:
            rate_hz: how often samples come.
            fingers: fingertips that are sampled together.
            strict: what it would warn of is an error.

        Raises:
            InvalidArgument: no rate that windows can be built at, or no number of fingertips.
        """
        if not is_whole(fingers):
            raise InvalidArgument(f"fingers is {fingers!r}: expected a whole number, at least 1")
        extras = self.manifest.window.extras
        rate_hz = checked_rate(rate_hz)
        check = self.input_check(rate_hz, strict=strict)
        return WindowStream(self.window, rate_hz=rate_hz, fingers=fingers, extras=extras, check=check)

    def input_check(self, rate_hz: float, *, strict: bool, of: str = "") -> InputCheck | None:
        """Compares samples that come at this rate with the training's; None if those are not known.

        Args:
            rate_hz: how often samples come.
            strict: whether what looks wrong is an error.
            of: whose samples they are, for the text.

        Raises:
            InvalidArgument: it is strict, and they are to come too slowly.
        """
        trained = self.manifest.trained_contacts
        if trained is None:
            return None
        label = f"{of}{self.manifest.label}"
        period_ns = period_of(rate_hz)
        ticks = rows_are_ticks(period_ns)
        return InputCheck(label, trained, period_ns / 1e9, ticks=ticks, strict=strict)

    def check_gives_spread(self) -> None:
        """Raise if the model gives no spread.

        Raises:
            InvalidArgument: the model is no ensemble.
        """
        if not self.manifest.gives_spread:
            raise InvalidArgument(
                f"outputs[1]: {self.manifest.label} gives no spread: expected an ensemble"
            )

    @override
    def __reduce__(self) -> NoReturn:
        raise InvalidArgument(NOT_PICKLED.format(type(self).__name__))


class Predictor(BasePredictor, ABC):
    """Turns windows into the 21 channels."""

    def fingers(
        self,
        count: int,
        *,
        rate_hz: float = 100.0,
        prime: Literal["rest"] | None = "rest",
        strict: bool = False,
    ) -> Fingers:
        """Many fingertips of a simulator, each with a clock, a reset and a past of its own.

        They warn (`taxel.errors.InputWarning`) of samples that look wrong beside those of the training.

        Args:
            count: how many there are.
            rate_hz: how often their `step` is called.
            prime: `"rest"`: begin as if nothing had touched for long. None: without a past.
            strict: what they would warn of is an error.

        Raises:
            InvalidArgument: `count` is below 1, or the rate is no positive number.
        """
        check = self.input_check(checked_rate(rate_hz), strict=strict)
        return Fingers(self, count, rate_hz=rate_hz, prime=prime, check=check)

    @abstractmethod
    def predict(self, windows: NDArray[Any], *, timeout: float | None = None) -> NDArray[np.float32]:
        """Predict the channels of each window.

        Args:
            windows: (n, f), raw values in m and N, columns as `window.features`; best float32.
                Extra features of the model, if it has any, may follow: `manifest.window.extras`.
            timeout: seconds that a server has to answer. The client waits for a quarter of it longer,
                0.25 s at most, so that a refusal arrives. A local predictor never waits.

        Returns:
            (n, 21) float32, counts, columns as `taxel.CHANNELS`.

        Raises:
            InvalidArgument: wrong shape or datatype, no rows, or a value that is not finite.
            RequestError: no prediction could be had; see `taxel.errors`.
        """

    @abstractmethod
    def predict_base(self, windows: NDArray[Any], *, timeout: float | None = None) -> NDArray[np.float32]:
        """Predict what the model file itself gives, without the effects that correct it.

        Frames turn the windows as they do for `predict`. Of a model without effects this is `predict`.

        Args:
            windows: as for `predict`, of the corrected model.
            timeout: as for `predict`.

        Returns:
            (n, 21) float32, counts: p, from which all terms are computed.

        Raises:
            InvalidArgument: as `predict`; or the model is corrected and a server evaluates it.
            RequestError: no prediction could be had.
        """

    @abstractmethod
    def predict_with_spread(
        self, windows: NDArray[Any], *, timeout: float | None = None
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Predict the channels, and the spread over the members of an ensemble.

        Args:
            windows: as for `predict`.
            timeout: as for `predict`.

        Returns:
            The channels and their standard deviation over the members, each (n, 21) float32, counts.

        Raises:
            InvalidArgument: as `predict`; or the model is no ensemble.
            RequestError: no prediction could be had.
        """


def _with_extras(windows: NDArray[Any], layout: WindowLayout) -> NDArray[Any]:
    """Windows with defaults for the extra features that are missing at the end."""
    most = len(layout.features)
    least = most - len(layout.extras)
    if windows.ndim != 2 or not least <= windows.shape[1] <= most:
        names = [extra.name for extra in layout.extras]
        raise InvalidArgument(
            f"window: shape {windows.shape}: expected (n, {least}) to (n, {most}), with extras {names}"
        )
    missing = most - windows.shape[1]
    if not missing:
        return windows
    defaults = np.array([extra.default for extra in layout.extras[-missing:]], np.float32)
    return np.hstack([windows, np.broadcast_to(defaults, (len(windows), missing))])


class PredictorSource(ABC):
    """Where predictors come from: a server (`taxel.connect`) or a repository (`taxel.load`)."""

    @override
    def __reduce__(self) -> NoReturn:
        raise InvalidArgument(NOT_PICKLED.format(type(self).__name__))

    @abstractmethod
    def models(self) -> list[ModelInfo]:
        """Every version of every model, sorted."""

    @abstractmethod
    def predictor(self, name: str = DEFAULT_MODEL, version: str | None = None) -> Predictor:
        """A predictor for a model, its newest version if none is named.

        Without a name, it is the causal model that comes with Taxel.

        Raises:
            NotFound: there is no such model or version.
        """

    @abstractmethod
    def close(self) -> None:
        """Release what the source holds; its predictors stop working."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()
