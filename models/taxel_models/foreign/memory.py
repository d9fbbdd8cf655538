"""Causes with a memory of the load: creep, hysteresis, and what depends on its rate."""

import numpy as np
from scipy.signal import fftconvolve

from taxel.windows.history import TICK_S
from taxel_models.foreign.injection import Floats, ForeignInjection


def creep_power_law(injection: ForeignInjection) -> None:
    """Findley's law: after each change of load, a strain grows as (t/s)^b."""
    exponent = float(injection.random.uniform(0.15, 0.4))

    def strain(load: Floats) -> Floats:
        kernel = (TICK_S * np.arange(len(load))) ** exponent
        return np.asarray(fftconvolve(np.diff(load, prepend=load[0]), kernel)[: len(load)])

    _weighted(injection, injection.in_segments(strain, injection.load), exponent=exponent)


def creep_two_constants(injection: ForeignInjection) -> None:
    """Two Kelvin-Voigt elements in series, one of tenths of seconds and one of seconds."""
    fast, slow = float(injection.random.uniform(0.2, 0.6)), float(injection.random.uniform(2.0, 6.0))
    share = float(injection.random.uniform(0.3, 0.7))
    from_rest, with_load = _variant(injection)
    quick, late = (injection.low_passed(injection.load, tau, from_rest=from_rest) for tau in (fast, slow))
    strain = share * quick + (1.0 - share) * late
    change = strain if with_load else strain - injection.load
    _weighted(
        injection, change, fast=fast, slow=slow, from_rest=float(from_rest), with_load=float(with_load)
    )


def creep_relaxing(injection: ForeignInjection) -> None:
    """The load's low-pass, or the load less it: a stress that relaxes."""
    tau = float(np.exp(injection.random.uniform(np.log(0.5), np.log(5.0))))
    from_rest, with_load = _variant(injection)
    late = injection.low_passed(injection.load, tau, from_rest=from_rest)
    change = late if with_load else injection.load - late
    _weighted(injection, change, time_constant=tau, from_rest=float(from_rest), with_load=float(with_load))


def hysteresis_bouc_wen(injection: ForeignInjection) -> None:
    """dz = dF (1 - |z|^n (b + g sgn(z dF))) (Bouc 1967, Wen 1976), in units of the yield load."""
    yields, sharp = _yield(injection), float(injection.random.uniform(1.0, 2.0))
    state = injection.in_segments(lambda load: _bouc_wen(load / yields, sharp, 0.0), injection.load)
    _weighted(injection, state, yields_n=yields, exponent=sharp)


def hysteresis_fading(injection: ForeignInjection) -> None:
    """The same, and the state fades within seconds: half hysteresis, half creep."""
    yields, fading = _yield(injection), float(injection.random.uniform(1.0, 4.0))
    state = injection.in_segments(
        lambda load: _bouc_wen(load / yields, 1.0, TICK_S / fading), injection.load
    )
    _weighted(injection, state, yields_n=yields, time_constant=fading)


def rate_saturating(injection: ForeignInjection) -> None:
    """tanh of the load's rate: friction that is full at some speed."""
    rate = _rate(injection)
    full = float(np.quantile(np.abs(rate), injection.random.uniform(0.6, 0.95))) + 1e-9
    _weighted(injection, np.tanh(rate / full), full_n_per_s=full)


def rate_root(injection: ForeignInjection) -> None:
    """The root of the load's rate: a fluid that thins when it is sheared."""
    rate = _rate(injection)
    _weighted(injection, np.sign(rate) * np.sqrt(np.abs(rate)))


def _variant(injection: ForeignInjection) -> tuple[bool, bool]:
    """Whether a creep begins from rest in each segment, and whether it has the load in it."""
    return bool(injection.random.random() < 0.5), bool(injection.random.random() < 0.5)


def _weighted(injection: ForeignInjection, course: Floats, **parameters: float) -> None:
    injection.add(course[:, None] * injection.free_weights(), **parameters)


def _yield(injection: ForeignInjection) -> float:
    return float(injection.random.uniform(0.2, 0.8) * injection.load.std())


def _bouc_wen(load: Floats, sharp: float, fading: float) -> Floats:
    state, states = 0.0, np.empty(len(load))
    for row, step in enumerate(np.diff(load, prepend=load[0]).tolist()):
        # Small steps keep the state within its bounds.
        parts = max(1, int(abs(step) / 0.05))
        for _ in range(parts):
            loss = abs(state) ** sharp * (0.5 + 0.5 * np.sign(state * step))
            state += step / parts * (1.0 - loss)
        state -= fading * state
        states[row] = state
    return states


def _rate(injection: ForeignInjection) -> Floats:
    smooth = injection.low_passed(injection.load, 0.03)
    return injection.in_segments(lambda part: np.gradient(part, TICK_S), smooth)
