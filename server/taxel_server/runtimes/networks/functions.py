"""Activations in float32, without branches, so that LLVM evaluates a register of values at once."""

from typing import Final

import numba
import numpy as np
from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic


def _coefficients(*values: float) -> tuple[np.float32, ...]:
    """Of a polynomial, that of the highest power first."""
    return tuple(np.float32(value) for value in values)


_LEAST: Final = np.float32(-87)
_GREATEST: Final = np.float32(88)
"""Beyond these, powers of e leave float32's normal numbers."""

_LOG2_E: Final = np.float32(1.44269504)
_LN_2_UPPER: Final = np.float32(0.693359375)
_LN_2_LOWER: Final = np.float32(-2.12194440e-4)
_EXPONENT_BIAS: Final = 127
_MANTISSA: Final = 23

_EXPONENTIAL: Final = _coefficients(
    1.9875691500e-4, 1.3981999507e-3, 8.3334519073e-3, 4.1665795894e-2, 1.6666665459e-1, 0.5
)
_TANGENT: Final = _coefficients(
    -5.70498872745e-3, 2.06390887954e-2, -5.37397155531e-2, 1.33314422036e-1, -3.33332819422e-1
)
_NEAR_ZERO: Final = np.float32(0.625)

_ERROR: Final = _coefficients(1.061405429, -1.453152027, 1.421413741, -0.284496736, 0.254829592)
_ERROR_SLOPE: Final = np.float32(0.3275911)
_SQRT_HALF: Final = np.float32(0.70710678)

_HALF: Final = np.float32(0.5)
_ONE: Final = np.float32(1)
_TWO: Final = np.float32(2)

_compiled: Final = numba.njit(error_model="numpy")
"""Without a branch for a division by zero."""


@intrinsic
def _float_of(_context, _bits):  # type: ignore[no-untyped-def]
    """The float32 whose bits are the low ones of an integer."""

    def generate(_context, builder, _signature, arguments):  # type: ignore[no-untyped-def]
        return builder.bitcast(builder.trunc(arguments[0], ir.IntType(32)), ir.FloatType())

    return types.float32(types.int64), generate


@_compiled
def exponential(x):  # type: ignore[no-untyped-def]
    """e**x, within 2 units in the last place; bounded where float32 ends (Cephes, expf)."""
    x = min(max(x, _LEAST), _GREATEST)
    twos = np.floor(x * _LOG2_E + _HALF)
    x = x - twos * _LN_2_UPPER
    x = x - twos * _LN_2_LOWER
    c5, c4, c3, c2, c1, c0 = _EXPONENTIAL
    series = ((((c5 * x + c4) * x + c3) * x + c2) * x + c1) * x + c0
    power = _float_of(np.int64(np.int32(twos) + _EXPONENT_BIAS) << _MANTISSA)
    return (series * x * x + x + _ONE) * power


@_compiled
def hyperbolic_tangent(x):  # type: ignore[no-untyped-def]
    """tanh(x), within 2 units in the last place (Cephes, tanhf)."""
    square = x * x
    c4, c3, c2, c1, c0 = _TANGENT
    near = ((((c4 * square + c3) * square + c2) * square + c1) * square + c0) * square * x + x
    size = abs(x)
    far = _ONE - _TWO / (exponential(_TWO * size) + _ONE)
    return near if size < _NEAR_ZERO else (far if x > 0 else -far)


@_compiled
def logistic(x):  # type: ignore[no-untyped-def]
    """1 / (1 + e**-x)."""
    return _ONE / (_ONE + exponential(-x))


@_compiled
def gaussian_linear(x):  # type: ignore[no-untyped-def]
    """x times the normal distribution's share below x, within 1.5e-7 of x.

    The error function is Abramowitz and Stegun's 7.1.26.
    """
    size = abs(x) * _SQRT_HALF
    t = _ONE / (_ONE + _ERROR_SLOPE * size)
    c4, c3, c2, c1, c0 = _ERROR
    series = ((((c4 * t + c3) * t + c2) * t + c1) * t + c0) * t
    beyond = _HALF * series * exponential(-size * size)
    return x * (beyond if x < 0 else _ONE - beyond)


@_compiled
def exponential_linear(x, scale):  # type: ignore[no-untyped-def]
    """x above 0, scale (e**x - 1) below."""
    return x if x > 0 else scale * (exponential(x) - _ONE)
