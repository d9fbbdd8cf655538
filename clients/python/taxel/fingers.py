"""Many fingertips of a simulator at once: one call a step, from contacts to the newest channels."""

from collections.abc import Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TYPE_CHECKING, Any, Final, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from taxel.arguments import is_whole
from taxel.channels import CHANNELS
from taxel.errors import InvalidArgument
from taxel.input_checks import InputCheck
from taxel.skin import PAD
from taxel.windows.checks import LARGEST, POSSIBLE
from taxel.windows.fingers import FingerWindows

if TYPE_CHECKING:
    from taxel.predictor import Predictor


_least: Final = np.minimum.reduce
_most: Final = np.maximum.reduce
"""Both are NaN where a number is."""


class _Asked(NamedTuple):
    """A request under way: for which fingertips, and how often each had been reset by then."""

    answer: Future[NDArray[np.float32]]
    ids: NDArray[np.int64]
    resets: NDArray[np.int64]


class Fingers:
    """Fingertips that step together, each with a clock, a reset and a past of its own.

    `predictor.fingers(n)` makes one:

        fingers = predictor.fingers(64)
        channels = fingers.step(position, force, dt=0.002)  # (64, 3), (64, 3) -> (64, 21)
        fingers.reset([3, 17])  # these two environments start again

    Args:
        predictor: predicts the channels.
        count: how many fingertips there are.
        rate_hz: how often `step` is called. Near 100 Hz each sample is a tick; at any other rate ticks are
            interpolated between samples.
        prime: `"rest"`: begin, and begin again after a reset, as if nothing had touched for long, so that
            the first step gives channels. None: channels are NaN until enough samples have come.
        check: looks at the samples, beside the contacts that the model was trained on.

    Attributes:
        channels: (count, 21) float32, the newest predictions, counts.
        delay_s: how long after its moment a prediction comes, s; 0 of a causal model.
    """

    def __init__(
        self,
        predictor: "Predictor",
        count: int,
        *,
        rate_hz: float,
        prime: Literal["rest"] | None = "rest",
        check: InputCheck | None = None,
    ) -> None:
        if not is_whole(count) or count < 1:
            raise InvalidArgument(f"count is {count!r}: expected a whole number, at least 1")
        if prime not in ("rest", None):
            raise InvalidArgument(f"prime is {prime!r}: expected 'rest' or None")
        self._predictor = predictor
        self._check = check
        self._windows = FingerWindows(
            predictor.window, count, rate_hz=rate_hz, extras=predictor.manifest.window.extras
        )
        self._prime_at_rest = prime == "rest"
        self.channels = np.full((count, len(CHANNELS)), np.nan, np.float32)
        self.delay_s = predictor.window.delay_s
        self._asking: ThreadPoolExecutor | None = None
        self._asked: _Asked | None = None
        self._waiting: NDArray[np.float32] | None = None
        self._waits = np.zeros(count, np.bool_)
        self._resets = np.zeros(count, np.int64)
        self.reset()

    def __len__(self) -> int:
        return self._windows.fingers

    def step(
        self,
        position: ArrayLike,
        force: ArrayLike,
        dt: ArrayLike | None = None,
        *,
        extras: Mapping[str, ArrayLike] | None = None,
        timeout: float | None = None,
        wait: bool = True,
    ) -> NDArray[np.float32]:
        """Take one sample of every fingertip and give the newest channels.

        Takes NumPy arrays, and CPU arrays of any library that speaks DLPack (torch, JAX), of any real type.
        They are read where they lie, also float32 ones, whatever their strides: they are not converted
        first. Their numbers go, as float64, straight into memory that the fingers keep: the newest sample
        of each, and a buffer of the check. So the caller may change its arrays afterwards. Lists become
        arrays first.

        Args:
            position: (count, 3), in each sensor's frame, m; `taxel.contacts` makes it from contacts.
            force: (count, 3), on each finger, N.
            dt: seconds since the last step, one number or (count,); 1 / rate_hz if not given. No window
                reaches across a gap of more than 50 ms (or 2.5 periods, if more).
            extras: extra features that the caller gives, such as `{"tdc": 1960.0}`: a number or (count,).
                A value holds until the next one.
            timeout: seconds to wait for a server's answer.
            wait: False: do not wait for this step's predictions. A thread asks for them; the newest that
                have come are given. While it asks, the newest window of each fingertip waits.

        Returns:
            (count, 21) float32, counts, columns as `taxel.CHANNELS`; a new array at each step, of which
            `torch.from_dlpack` makes a tensor without a copy.

        Raises:
            InvalidArgument: a shape is wrong, a number is not finite or not positive, an extra is none or
                is computed, or something looks wrong and they are strict. Nothing is changed.
            RequestError: no prediction could be had, in this step or, without waiting, in an earlier one.
                The samples are taken; `channels` stay as they were.
        """
        count = len(self)
        places = _numbers("position", position, (count, 3))
        forces = _numbers("force", force, (count, 3))
        seconds = None if dt is None else _numbers("dt", dt, (count,))
        if seconds is not None and not (seconds > 0.0).all():
            raise InvalidArgument(f"dt is {seconds[seconds <= 0.0][0]}: expected more than 0 s")
        given = {name: _numbers(name, values, (count,)) for name, values in (extras or {}).items()}
        self._check_names(given)
        if self._check is not None:
            self._check.take(places, forces, seconds)
            for name, values in given.items():
                self._check.extra(name, values)
        dt_ns = self._windows.period_ns if seconds is None else _nanoseconds(seconds)
        ids, windows = self._windows.step(places, forces, dt_ns, given)
        if wait:
            self._settle(ids, self._predictor.predict(windows, timeout=timeout) if len(ids) else None)
        else:
            self._ask(ids, windows, timeout)
        return self.channels.copy()

    def reset(self, ids: ArrayLike | None = None) -> None:
        """Begin again, as at the start of an episode: these fingertips, (m,) numbers, or all of them.

        Raises:
            InvalidArgument: there is no such fingertip.
        """
        which = self._ids(ids)
        self._windows.reset(which)
        self._forget(which)
        channels = self.channels.copy()
        channels[which] = np.nan
        self.channels = channels
        if self._prime_at_rest:
            self._prime(np.tile(np.array(PAD), (len(which), 1)), np.zeros((len(which), 3)), which)

    def prime(self, position: ArrayLike, force: ArrayLike, ids: ArrayLike | None = None) -> None:
        """Begin again as if these fingertips had been touched so, without a change, for long.

        Args:
            position: (m, 3), in each sensor's frame, m.
            force: (m, 3), N.
            ids: (m,) fingertips; all if not given.

        Raises:
            InvalidArgument: a shape is wrong, a number is not finite, there is no such fingertip, or
                something looks wrong and they are strict. Nothing is changed.
        """
        which = self._ids(ids)
        places = _numbers("position", position, (len(which), 3))
        forces = _numbers("force", force, (len(which), 3))
        if self._check is not None:
            self._check.look(places, forces)
        self._prime(places, forces, which)

    def _prime(self, places: NDArray[Any], forces: NDArray[Any], ids: NDArray[np.int64]) -> None:
        self._windows.prime(ids, places, forces)
        self._forget(ids)

    def _forget(self, ids: NDArray[np.int64]) -> None:
        """Do not take answers that these fingertips still wait for."""
        self._resets[ids] += 1
        self._waits[ids] = False

    def close(self) -> None:
        """End the thread that asks for predictions, if there is one; a request under way is waited for."""
        if self._asking is not None:
            self._asking.shutdown()
            self._asking = None

    def _ask(self, ids: NDArray[np.int64], windows: NDArray[np.float32], timeout: float | None) -> None:
        """Take the answer that has come, and ask for what waits if nobody is asking."""
        if self._waiting is None:
            self._waiting = np.zeros((len(self), windows.shape[1]), np.float32)
        self._waiting[ids] = windows
        self._waits[ids] = True
        if self._asked is not None and self._asked.answer.done():
            asked, self._asked = self._asked, None
            # A fingertip that was reset since then does not take an answer of its past.
            current = self._resets[asked.ids] == asked.resets
            self._settle(asked.ids[current], asked.answer.result()[current])
        if self._asked is None and self._waits.any():
            if self._asking is None:
                self._asking = ThreadPoolExecutor(1, thread_name_prefix="taxel-fingers")
            due = np.flatnonzero(self._waits)
            self._waits[:] = False
            answer = self._asking.submit(self._predictor.predict, self._waiting[due], timeout=timeout)
            self._asked = _Asked(answer, due, self._resets[due])

    def _settle(self, ids: NDArray[np.int64], predicted: NDArray[np.float32] | None) -> None:
        """Give fingertips their new channels, in a new array: who kept the old one may change it."""
        if predicted is None or not len(ids):
            return
        if len(ids) < len(self):
            channels = self.channels.copy()
            channels[ids] = predicted
            predicted = channels
        self.channels = predicted

    def _check_names(self, given: Mapping[str, Any]) -> None:
        for name in given:
            if name not in self._windows.given:
                known = ", ".join(self._windows.given) or "none"
                raise InvalidArgument(
                    f"no extra feature {name!r} is given by the caller; there is: {known}"
                )

    def _ids(self, ids: ArrayLike | None) -> NDArray[np.int64]:
        count = len(self)
        if ids is None:
            return np.arange(count)
        which = np.atleast_1d(np.asarray(ids))
        if which.dtype == np.bool_ and which.shape == (count,):
            return np.flatnonzero(which)
        if which.ndim != 1 or (which.size and which.dtype.kind not in "iu"):
            raise InvalidArgument(f"ids is {ids!r}: expected whole numbers (m,), or {count} booleans")
        if which.size and (which.min() < 0 or which.max() >= count):
            raise InvalidArgument(f"ids has {which.min()} to {which.max()}: expected 0 to {count - 1}")
        return which.astype(np.int64)


def _numbers(name: str, values: ArrayLike, shape: tuple[int, ...]) -> NDArray[Any]:
    """Checked real numbers of this shape, of the type that they have; a real array is not copied.

    One number stands for all where `shape` has one axis.
    """
    try:
        foreign: Any = values
        if not isinstance(foreign, np.ndarray) and hasattr(foreign, "__dlpack__"):
            foreign = np.from_dlpack(foreign)
        array: NDArray[Any] = np.asarray(foreign)
        if array.dtype.kind == "c":
            raise TypeError("complex numbers")
        if array.dtype.kind not in "fiub":
            array = np.asarray(foreign, dtype=np.float64)
        if len(shape) == 1 and not array.ndim:
            array = np.full(shape, array)
    except (TypeError, ValueError, RuntimeError, BufferError) as error:
        raise InvalidArgument(f"{name}: {error}: expected numbers of shape {shape} on the CPU") from None
    if array.shape != shape:
        raise InvalidArgument(f"{name} has shape {array.shape}: expected {shape}")
    # False for NaN, too. Finding the two ends takes no further array.
    if array.size and not (float(_least(array, None)) >= -LARGEST and float(_most(array, None)) <= LARGEST):
        fits = np.abs(array.astype(np.float64)) <= LARGEST
        row = int(np.argmin(fits.reshape(len(array), -1).all(axis=1)))
        raise InvalidArgument(f"{name}[{row}] is {array[row].tolist()}: expected {POSSIBLE}")
    return array


def _nanoseconds(seconds: NDArray[Any]) -> NDArray[np.int64]:
    """Rounded from float64, since float32 has too few digits."""
    exact: NDArray[np.float64] = np.multiply(seconds, 1e9, dtype=np.float64)
    return np.rint(exact).astype(np.int64)
