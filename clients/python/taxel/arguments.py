"""The checks of a call's arguments: what has the wrong type or value is told at once."""

from numbers import Integral, Real
from typing import Any, Final

from taxel.errors import InvalidArgument

_LONGEST_S: Final = 1e6
"""zenoh and the operating system count in smaller units, which a longer time would overflow."""


def is_real(value: Any) -> bool:
    """Whether this is a number, Python's or NumPy's; True and False are none."""
    return isinstance(value, Real) and not isinstance(value, bool)


def is_whole(value: Any) -> bool:
    """Whether this is a whole number, Python's or NumPy's; True and False are none."""
    return isinstance(value, Integral) and not isinstance(value, bool)


def checked_timeout(timeout: Any) -> float:
    """A timeout in seconds.

    Raises:
        InvalidArgument: it is not a number above 0 and below 1e6.
    """
    if not is_real(timeout) or not 0 < timeout < _LONGEST_S:
        raise InvalidArgument(f"timeout is {timeout!r}: expected seconds above 0 and below {_LONGEST_S:g}")
    return float(timeout)


def checked_flag(name: str, value: Any) -> bool:
    """An argument that is either True or False.

    Raises:
        InvalidArgument: it is neither.
    """
    if not isinstance(value, bool):
        raise InvalidArgument(f"{name} is {value!r}: expected True or False")
    return value


def checked_version(version: Any) -> str | None:
    """The version of a model, or None for the newest.

    Raises:
        InvalidArgument: it is neither a text nor None.
    """
    if not (version is None or isinstance(version, str)):
        raise InvalidArgument(
            f"version is {version!r}: expected a text such as '1', or None for the newest"
        )
    return version


def checked_microseconds(name: str, value: Any) -> int:
    """An argument in microseconds.

    Raises:
        InvalidArgument: it is not a whole number from 0 to 100,000.
    """
    if not is_whole(value) or not 0 <= value <= 100_000:
        raise InvalidArgument(f"{name} is {value!r}: expected a whole number from 0 to 100000")
    return int(value)


def checked_rate(rate_hz: Any) -> float:
    """A rate of samples in Hz.

    Raises:
        InvalidArgument: it is not a number from 1 to 1e9.
    """
    if not is_real(rate_hz) or not 1.0 <= rate_hz <= 1e9:
        interval = is_real(rate_hz) and 0.0 < rate_hz < 1.0
        looks = f", as {1.0 / rate_hz:g} for a sample every {rate_hz:g} s" if interval else ""
        raise InvalidArgument(f"rate_hz is {rate_hz!r}: expected samples a second, from 1{looks}")
    return float(rate_hz)
