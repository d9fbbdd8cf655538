"""Decimals in a text as float32, each rounded once, at hundreds of megabytes a second."""

from fractions import Fraction

import numpy as np

from taxel_server.runtimes.compiled.compiling import compiled

_COMMA, _CLOSE, _DOT, _PLUS, _MINUS, _ZERO, _NINE, _UPPER_E, _LOWER_E = b",].+-09Ee"
_POWERS_OF_TEN = 10.0 ** np.arange(23)


def nearest(token: str) -> np.float32:
    """The float32 nearest to a decimal, ties to even: a detour over float64 would round twice."""
    with np.errstate(over="ignore", under="ignore"):
        guess = np.float32(float(token))
        near = [guess, *(np.nextafter(guess, np.float32(side)) for side in (-np.inf, np.inf))]
    if not np.isfinite(guess):
        return guess
    exact = Fraction(token)
    finite = [value for value in near if np.isfinite(value)]
    return min(
        finite, key=lambda value: (abs(Fraction(float(value)) - exact), int(value.view(np.int32)) & 1)
    )


@compiled
def read_numbers(text, spans, values, odd):  # type: ignore[no-untyped-def]
    """Reads arrays into float64; returns how many tokens are `odd`: left to be read with more care.

    Odd is whatever is no plain decimal, and every decimal so near to the middle of two float32
    that its float64 (good to 4 units in the last place here) cannot tell to which side it belongs.
    """
    place, odds = 0, 0
    for array in range(spans.shape[0]):
        if spans[array, 2] == 0:
            continue
        position, end = spans[array, 0], spans[array, 1]
        while position <= end:
            start = position
            value, position = _read_decimal(text, position)
            if position < 0:
                position = start
                while text[position] != _COMMA and position < end:
                    position += 1
                if odds < odd.shape[0]:
                    odd[odds, 0], odd[odds, 1], odd[odds, 2] = place, start, position
                odds += 1
            values[place] = value
            place += 1
            position += 1
    return odds


@compiled
def _read_decimal(text, position):  # type: ignore[no-untyped-def]
    """One number, and the place of the comma or bracket behind it: -1 if it is odd."""
    mantissa, exponent, digits = np.int64(0), 0, 0
    negative = text[position] == _MINUS
    position += negative
    while _ZERO <= text[position] <= _NINE:
        mantissa = mantissa * 10 + (text[position] - _ZERO)
        digits += 1
        position += 1
    if text[position] == _DOT:
        position += 1
        while _ZERO <= text[position] <= _NINE:
            mantissa = mantissa * 10 + (text[position] - _ZERO)
            digits += 1
            exponent -= 1
            position += 1
    if digits == 0 or digits > 15:
        return 0.0, -1
    power, position = _read_exponent(text, position)
    exponent += power
    if position < 0 or (text[position] != _COMMA and text[position] != _CLOSE):
        return 0.0, -1
    if exponent < -44 or exponent > 22:
        return 0.0, -1
    value = np.float64(mantissa)
    if exponent > 0:
        value *= _POWERS_OF_TEN[exponent]
    elif exponent < 0:
        first = min(-exponent, 22)
        value = value / _POWERS_OF_TEN[first] / _POWERS_OF_TEN[-exponent - first]
    return (-value if negative else value), (-1 if _may_round_twice(value) else position)


@compiled
def _read_exponent(text, position):  # type: ignore[no-untyped-def]
    """The power of ten that may follow a decimal, and the place behind it: -1 if it is odd."""
    if text[position] != _UPPER_E and text[position] != _LOWER_E:
        return 0, position
    position += 1
    down = text[position] == _MINUS
    position += down or text[position] == _PLUS
    power, digits = 0, 0
    while _ZERO <= text[position] <= _NINE and digits < 4:
        power = power * 10 + (text[position] - _ZERO)
        digits += 1
        position += 1
    return (-power if down else power), (position if digits else -1)


@compiled
def _may_round_twice(value):  # type: ignore[no-untyped-def]
    # A float64 has 29 bits more than a float32: the middle of two float32 has only the first set.
    below = np.float64(value).view(np.int64) & ((1 << 29) - 1)
    return abs(below - (1 << 28)) <= 8 or (value != 0.0 and value < 1.2e-38) or value > 3.4e38
