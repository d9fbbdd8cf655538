"""Injects each effect.

The injectors are separate code, but they use the loop's features and nearly always its form of each effect:
the benchmark tests the selection, not the equations.
"""

from collections.abc import Callable, Mapping
from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

from taxel.channels import CHANNELS, COUNTS_MAX
from taxel.errors import SettingsError
from taxel.windows import Load, Play, Relaxation
from taxel.windows.history import TICK_S, TOUCH_N, Rate
from taxel_models.loop.basis import Floats
from taxel_models.loop.effects.location import farthest_points
from taxel_models.loop.effects.registry import effect_named
from taxel_models.loop.resting import are_raw
from taxel_models.recordings.kinds import are_kinds
from taxel_models.recovery.injection import Injection

MOST_LAG_TICKS: Final = 15
MOST_DEG: Final = 45.0
LIGHT_DEG: Final = 15.0
"""Of the forces: about what a strength of 1 stands for. A turn of inputs cannot be scaled to a residual."""

HALF_FORCE_N: Final = 0.5


def inject(injection: Injection, name: str, strength: float) -> None:
    """Put an effect into a recording, with parameters drawn at random.

    Args:
        name: of an effect, such as `creep` or `covariate:material`.
        strength: of the change over the residual.

    Raises:
        SettingsError: there is no such effect, or it changes nothing in this recording.
    """
    effect_named(name)
    injection.begin(name, strength)
    kind, _, column = name.partition(":")
    if column:
        _covariate(injection, column)
    else:
        INJECTORS[kind](injection)


def _offset(injection: Injection) -> None:
    values = injection.random.normal(size=len(CHANNELS))
    injection.add(np.broadcast_to(values, injection.recording.channels.shape), {"offset": values})


def _gain(injection: Injection) -> None:
    alike = injection.random.random() < 0.5
    gains = np.ones(len(CHANNELS)) if alike else injection.random.normal(1.0, 0.4, len(CHANNELS))
    gains *= injection.random.choice([-1.0, 1.0])
    injection.add(injection.signal * gains, {"gain": gains})


def _load(injection: Injection) -> None:
    weights = _channel_weights(injection)
    injection.add(injection.history(Load(of="force"))[:, None] * weights, {"weight": weights})


def _drift(injection: Injection) -> None:
    time = injection.time_s / injection.time_s[-1]
    rise = 1.0 - np.exp(-time / injection.random.uniform(0.2, 1.0))
    shape = time if injection.random.random() < 0.5 else rise
    amplitudes = injection.random.normal(1.0, 0.5, len(CHANNELS)) * injection.random.choice([-1.0, 1.0])
    injection.add((shape - shape.mean())[:, None] * amplitudes, {"amplitude": amplitudes})


def _temperature(injection: Injection) -> None:
    """Of raw counts a shift of ln Z, of tared ones a shift of counts; electrodes only."""
    tdc = injection.recording.auxiliary["tdc"]
    warmer = tdc - tdc.mean()
    slopes = injection.random.normal(1.0, 0.2, len(CHANNELS)) * injection.random.choice([-1.0, 1.0])
    counts = injection.recording.channels
    raw = are_raw(injection.rest)
    steepness = counts * (1.0 - counts / COUNTS_MAX) if raw else np.ones_like(counts)
    steepness[:, :2] = 0.0
    injection.add(warmer[:, None] * steepness * slopes, {"slope": slopes})


def _creep(injection: Injection) -> None:
    tau = float(np.exp(injection.random.uniform(np.log(0.3), np.log(10.0))))
    relaxation = injection.history(Relaxation(of="force", time_constant_s=tau))
    weights = _channel_weights(injection)
    injection.add(relaxation[:, None] * weights, {"weight": weights}, time_constant=tau)


def _hysteresis(injection: Injection) -> None:
    width = float(np.exp(injection.random.uniform(np.log(0.15), np.log(1.0))))
    play = injection.history(Play(of="force", width_n=width))
    weights = _channel_weights(injection)
    injection.add(play[:, None] * weights, {"weight": weights}, width=width)


def _rate(injection: Injection) -> None:
    rate = injection.history(Rate(of="force"))
    weights = _channel_weights(injection)
    injection.add(rate[:, None] * weights, {"weight": weights})


def _channel_weights(injection: Injection) -> Floats:
    return np.asarray(injection.random.normal(0.0, 1.0, len(CHANNELS)) * injection.residual)


def _lag(injection: Injection) -> None:
    recording = injection.recording
    rows, first = np.arange(len(recording)), np.zeros(len(recording), np.int64)
    for segment in recording.segments:
        first[segment] = segment.start

    def trailing(ticks: int) -> Floats:
        return recording.channels[np.maximum(rows - ticks, first)]

    def apart(ticks: int) -> float:
        found = injection.strength_of(trailing(ticks) - recording.channels)
        return float(abs(np.log(max(found, 1e-9) / injection.strength)))

    # A delay does not scale.
    nearest = min(range(1, MOST_LAG_TICKS + 1), key=apart)
    injection.replace_channels(trailing(nearest), lag=nearest * TICK_S, unit="s")


def _frame(injection: Injection) -> None:
    samples = injection.recording.samples
    axis = injection.random.normal(size=3)
    axis /= np.linalg.norm(axis)
    angle = _angle(injection, axis)
    force = Rotation.from_rotvec(axis * np.radians(angle)).apply(samples.force)
    injection.turn_forces(force, angle=angle, unit="deg")


def _angle(injection: Injection, axis: Floats) -> float:
    """Degrees that make the strength, by what a model answers; in proportion to it without one."""
    samples = injection.recording.samples
    if injection.respond is None:
        return LIGHT_DEG * injection.strength
    still = injection.respond(samples.position, samples.force)
    angles = np.geomspace(1.0, MOST_DEG, 12)
    strengths = [
        injection.strength_of(
            injection.respond(
                samples.position, Rotation.from_rotvec(axis * np.radians(angle)).apply(samples.force)
            )
            - still
        )
        for angle in angles
    ]
    return float(angles[np.argmin(np.abs(np.log(np.maximum(strengths, 1e-9) / injection.strength)))])


def _location(injection: Injection) -> None:
    position, force = injection.recording.samples.position, injection.pressed
    touched = position[force > TOUCH_N]
    centres = farthest_points(touched, 6)
    width = float(np.linalg.norm(touched.std(axis=0))) * 0.5
    squared = ((position[:, None] - centres[None]) ** 2).sum(axis=2)
    bumps = (force / (force + HALF_FORCE_N))[:, None] * np.exp(-squared / (2 * width**2))
    weights = injection.random.normal(size=(6, len(CHANNELS))) * injection.residual
    injection.add(bumps @ weights, {}, width=width * 1e3)


def _crosstalk(injection: Injection) -> None:
    pairs = injection.random.permutation(len(CHANNELS))[:6].reshape(3, 2)
    delta = np.zeros_like(injection.signal)
    for to, source in pairs:
        delta[:, to] = injection.signal[:, source]
    names = [f"{CHANNELS[source]} into {CHANNELS[to]}" for to, source in pairs]
    injection.add(delta, {"leak": np.ones(3)}, pairs=", ".join(names))


def _saturation(injection: Injection) -> None:
    signal, touched = injection.signal, injection.pressed > TOUCH_N
    quantile = float(injection.random.uniform(0.5, 0.85))
    level = np.quantile(np.abs(signal[touched]), quantile, axis=0)
    slope = injection.random.uniform(0.7, 1.3, len(CHANNELS))
    lost = np.clip(signal, -level, level) - signal
    injection.add(lost * slope, {"slope": slope}, quantile=quantile)


def _fault(injection: Injection) -> None:
    channel = int(injection.random.integers(len(CHANNELS)))
    kind = str(injection.random.choice(["dead", "stuck", "intermittent"]))
    counts = injection.recording.channels.copy()
    rows = np.zeros(len(counts), bool)
    if kind == "intermittent":
        for _ in range(12):
            start = int(injection.random.integers(len(counts)))
            rows[start : start + int(injection.random.integers(60, len(counts) // 60 + 61))] = True
    else:
        rows[:] = True
    value = 0.0
    if kind != "dead":
        value = float(counts[int(injection.random.integers(len(counts))), channel])
    counts[rows, channel] = value
    injection.replace_channels(counts, channel=CHANNELS[channel], kind=kind)


def _interference(injection: Injection) -> None:
    """A wave with its second harmonic, of an amplitude of its own in each of 3 to 8 channels."""
    random = injection.random
    frequency = float(random.uniform(3.0, 20.0))
    chosen = np.sort(random.permutation(len(CHANNELS))[: int(random.integers(3, 9))])
    first, second = random.uniform(0.0, 2 * np.pi, 2)
    phase = 2 * np.pi * frequency * injection.time_s
    wave = np.sin(phase + first) + 0.3 * np.sin(2 * phase + second)
    amplitudes = np.zeros(len(CHANNELS))
    amplitudes[chosen] = random.uniform(0.7, 1.3, len(chosen)) * injection.residual[chosen]
    names = ", ".join(CHANNELS[channel] for channel in chosen)
    injection.add(
        wave[:, None] * amplitudes, {"amplitude": amplitudes}, frequency=frequency, channels=names
    )


def _covariate(injection: Injection, column: str) -> None:
    covariates = injection.recording.covariates
    if column not in covariates:
        known = ", ".join(covariates) or "none"
        raise SettingsError(f"no column {column!r} to inject by; the recording has: {known}")
    values = covariates[column]
    kinds, places = np.unique(values, return_inverse=True)
    if are_kinds(kinds):
        weights = injection.random.normal(size=(len(kinds), len(CHANNELS))) * injection.residual
        injection.add(weights[places], {"weight": weights})
    else:
        weights = _channel_weights(injection)
        injection.add((values - values.mean())[:, None] * weights, {"weight": weights})


INJECTORS: Final[Mapping[str, Callable[[Injection], None]]] = {
    "offset": _offset,
    "gain": _gain,
    "load": _load,
    "drift": _drift,
    "temperature": _temperature,
    "creep": _creep,
    "hysteresis": _hysteresis,
    "rate": _rate,
    "lag": _lag,
    "frame": _frame,
    "location": _location,
    "crosstalk": _crosstalk,
    "saturation": _saturation,
    "fault": _fault,
    "interference": _interference,
}
"""By the effect's name."""
