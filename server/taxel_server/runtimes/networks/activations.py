"""Activations in float32, without branches, so that LLVM evaluates a register of values at once.

Each takes a value and up to two parameters, as ONNX names them.
"""

from typing import Final

import numpy as np

from taxel_server.runtimes.compiled.compiling import strict

_LEAST: Final = np.float32(-87)
_GREATEST: Final = np.float32(88)
"""Beyond these bounds, powers of e are no normal float32 numbers."""

_LOG2_E: Final = np.float32(1.44269504)
_LN_2_UPPER: Final = np.float32(0.693359375)
_LN_2_LOWER: Final = np.float32(-2.12194440e-4)
_EXPONENT_BIAS: Final = np.int32(127)
_MANTISSA_BITS: Final = np.int32(23)

_EXPONENTIAL: Final = tuple(
    np.float32(value)
    for value in (1.9875691500e-4, 1.3981999507e-3, 8.3334519073e-3, 4.1665795894e-2, 1.6666665459e-1, 0.5)
)
_ERROR: Final = tuple(
    np.float32(value) for value in (1.061405429, -1.453152027, 1.421413741, -0.284496736, 0.254829592)
)
"""Coefficients of polynomials, the highest power first."""

_ERROR_SLOPE: Final = np.float32(0.3275911)
_SQRT_HALF: Final = np.float32(0.70710678)

_ZERO: Final = np.float32(0)
_HALF: Final = np.float32(0.5)
_ONE: Final = np.float32(1)


@strict
def exponential(x: np.float32) -> np.float32:
    """e**x, within 2 units in the last place (Cephes, expf); x is clipped to the bounds."""
    x = min(max(x, _LEAST), _GREATEST)
    twos = np.floor(x * _LOG2_E + _HALF)
    x = x - twos * _LN_2_UPPER
    x = x - twos * _LN_2_LOWER
    c5, c4, c3, c2, c1, c0 = _EXPONENTIAL
    series = ((((c5 * x + c4) * x + c3) * x + c2) * x + c1) * x + c0
    power = np.int32((np.int32(twos) + _EXPONENT_BIAS) << _MANTISSA_BITS).view(np.float32)
    return (series * x * x + x + _ONE) * power


@strict
def relu(x: np.float32, _alpha: np.float32, _beta: np.float32) -> np.float32:
    """The greater of x and 0."""
    return max(x, _ZERO)


@strict
def leaky_relu(x: np.float32, alpha: np.float32, _beta: np.float32) -> np.float32:
    """x above 0, alpha x below."""
    return x if x > _ZERO else alpha * x


@strict
def clip(x: np.float32, least: np.float32, greatest: np.float32) -> np.float32:
    """x within bounds."""
    return min(max(x, least), greatest)


@strict
def tanh(x: np.float32, _alpha: np.float32, _beta: np.float32) -> np.float32:
    """The hyperbolic tangent of the system's library: our own polynomial would save at most 9 %."""
    return np.float32(np.tanh(x))


@strict
def sigmoid(x: np.float32, _alpha: np.float32, _beta: np.float32) -> np.float32:
    """1 / (1 + e**-x)."""
    return _ONE / (_ONE + exponential(-x))


@strict
def elu(x: np.float32, alpha: np.float32, _beta: np.float32) -> np.float32:
    """x above 0, alpha (e**x - 1) below."""
    return x if x > _ZERO else alpha * (exponential(x) - _ONE)


@strict
def gelu(x: np.float32, _alpha: np.float32, _beta: np.float32) -> np.float32:
    """x times the normal distribution function of x, with an error of at most 1.5e-7 x.

    The error function is Abramowitz and Stegun's 7.1.26.
    """
    size = abs(x) * _SQRT_HALF
    t = _ONE / (_ONE + _ERROR_SLOPE * size)
    c4, c3, c2, c1, c0 = _ERROR
    series = ((((c4 * t + c3) * t + c2) * t + c1) * t + c0) * t
    beyond = _HALF * series * exponential(-size * size)
    return x * (beyond if x < _ZERO else _ONE - beyond)
