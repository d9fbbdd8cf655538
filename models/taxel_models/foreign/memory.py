"""Causes with a memory of the load: creep, hysteresis, and what depends on its rate."""

import numpy as np
from scipy.signal import fftconvolve, lfilter

from taxel_models.foreign.planting import Floats, Planting

TICK_S = 0.01


def creep_power_law(planting: Planting) -> None:
    """Findley's law: after each change of load, a strain grows as (t/s)^b."""
    exponent = float(planting.random.uniform(0.15, 0.4))

    def strain(load: Floats) -> Floats:
        kernel = (TICK_S * np.arange(len(load))) ** exponent
        return np.asarray(fftconvolve(np.diff(load, prepend=load[0]), kernel)[: len(load)])

    _weighted(planting, planting.in_segments(strain, planting.load), exponent=exponent)


def creep_two_constants(planting: Planting) -> None:
    """Two Kelvin-Voigt elements in series, one of tenths of seconds and one of seconds."""
    fast, slow = float(planting.random.uniform(0.2, 0.6)), float(planting.random.uniform(2.0, 6.0))
    share = float(planting.random.uniform(0.3, 0.7))
    strain = share * _smoothed(planting, planting.load, fast) + (1.0 - share) * _smoothed(
        planting, planting.load, slow
    )
    _weighted(planting, strain - planting.load, fast=fast, slow=slow)


def creep_relaxing(planting: Planting) -> None:
    """The load less its low-pass: a stress that relaxes."""
    tau = float(np.exp(planting.random.uniform(np.log(0.5), np.log(5.0))))
    _weighted(planting, planting.load - _smoothed(planting, planting.load, tau), time_constant=tau)


def hysteresis_bouc_wen(planting: Planting) -> None:
    """dz = dF (1 - |z|^n (b + g sgn(z dF))) (Bouc 1967, Wen 1976), in units of the yield load."""
    yields, sharp = _yield(planting), float(planting.random.uniform(1.0, 2.0))
    state = planting.in_segments(lambda load: _bouc_wen(load / yields, sharp, 0.0), planting.load)
    _weighted(planting, state, yields_n=yields, exponent=sharp)


def hysteresis_fading(planting: Planting) -> None:
    """The same, and the state fades within seconds: half hysteresis, half creep."""
    yields, fading = _yield(planting), float(planting.random.uniform(1.0, 4.0))
    state = planting.in_segments(lambda load: _bouc_wen(load / yields, 1.0, TICK_S / fading), planting.load)
    _weighted(planting, state, yields_n=yields, time_constant=fading)


def rate_saturating(planting: Planting) -> None:
    """tanh of the load's rate: friction that is full at some speed."""
    rate = _rate(planting)
    full = float(np.quantile(np.abs(rate), planting.random.uniform(0.6, 0.95))) + 1e-9
    _weighted(planting, np.tanh(rate / full), full_n_per_s=full)


def rate_root(planting: Planting) -> None:
    """The root of the load's rate: a fluid that thins when it is sheared."""
    rate = _rate(planting)
    _weighted(planting, np.sign(rate) * np.sqrt(np.abs(rate)))


def _weighted(planting: Planting, course: Floats, **parameters: float) -> None:
    planting.add(course[:, None] * planting.free_weights(), **parameters)


def _smoothed(planting: Planting, column: Floats, tau: float) -> Floats:
    keep = float(np.exp(-TICK_S / tau))

    def low_pass(part: Floats) -> Floats:
        return np.asarray(lfilter([1.0 - keep], [1.0, -keep], part, zi=[keep * part[0]])[0])

    return planting.in_segments(low_pass, column)


def _yield(planting: Planting) -> float:
    return float(planting.random.uniform(0.2, 0.8) * planting.load.std())


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


def _rate(planting: Planting) -> Floats:
    smooth = _smoothed(planting, planting.load, 0.03)
    return planting.in_segments(lambda part: np.gradient(part, TICK_S), smooth)
