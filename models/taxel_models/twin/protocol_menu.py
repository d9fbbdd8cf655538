"""Short recording protocols, each of which shows what most recordings leave open."""

from collections.abc import Sequence
from typing import Final

from taxel_models.twin.protocol import (
    Column,
    Pause,
    Place,
    Press,
    RecordingProtocol,
    Step,
    SwitchOff,
    Turn,
    WarmUp,
)

_UNDERSIDE: Final = Place(along_mm=-4.0, around_deg=0.0)
_SIDE: Final = Place(along_mm=-6.0, around_deg=50.0)
_TIP: Final = Place(along_mm=4.0, around_deg=-15.0)
_THREE: Final = (_UNDERSIDE, _SIDE, _TIP)

_MANY: Final = tuple(
    Place(along_mm=along, around_deg=around)
    for along in (-11.0, -7.0, -3.0, 4.0)
    for around in (-55.0, 0.0, 55.0)
)
_STEP: Final = 5
"""Of twelve places the fifth next one: neighbours in time are far apart on the skin."""

_HALF_WARM_S: Final = 1300.0
_SWING_S: Final = 600.0
"""From half warm, on and off for as long let the temperature swing about a level, without a trend."""

_TURNS: Final = (0.0, 40.0, -80.0, 40.0)
_SHEARS: Final = ((0.3, 0.0), (0.0, 0.3), (-0.3, 0.0), (0.0, -0.3))


def menu(force_n: float) -> tuple[RecordingProtocol, ...]:
    """Every protocol that asks nothing but presses, time and a turn of the finger.

    Args:
        force_n: the largest force, N.
    """
    return (
        _hold_and_release(force_n),
        _two_speeds(force_n),
        _pauses(force_n),
        _other_places(force_n),
        _rising_force(force_n),
        _turned_finger(force_n),
        _warm_up(force_n),
    )


def in_turn(force_n: float, column: str, values: Sequence[float]) -> RecordingProtocol:
    """The same presses for each value of a column, round after round, so that no value goes with a time."""
    presses = tuple(Press(place=place, force_n=force_n) for place in _THREE)
    steps: list[Step] = []
    for value in values:
        steps += [Column(column=column, value=value), *presses]
    seconds = len(values) * sum(press.seconds for press in presses)
    return RecordingProtocol(
        name=f"{column} in turn",
        about=f"Press the same three places with each {column}, then all again, round after round.",
        repeat=max(2, round(90.0 / seconds)),
        steps=tuple(steps),
    )


def _hold_and_release(force_n: float) -> RecordingProtocol:
    return RecordingProtocol(
        name="hold and release",
        about="Press quickly, hold, release, and wait as long.",
        repeat=3,
        steps=tuple(
            step
            for place in _THREE
            for step in (
                Press(place=place, force_n=force_n, speed_n_s=10 * force_n, hold_s=5.0),
                Pause(seconds=4.0),
            )
        ),
    )


def _two_speeds(force_n: float) -> RecordingProtocol:
    return RecordingProtocol(
        name="the same press at two speeds",
        about="Press each place slowly, then quickly, to the same force.",
        repeat=4,
        steps=tuple(
            Press(place=place, force_n=force_n, speed_n_s=speed, hold_s=0.5)
            for place in _THREE
            for speed in (force_n / 2.0, 8 * force_n)
        ),
    )


def _pauses(force_n: float) -> RecordingProtocol:
    return RecordingProtocol(
        name="pauses",
        about="Press three places, then touch nothing for as long.",
        repeat=8,
        steps=(*(Press(place=place, force_n=force_n) for place in _THREE), Pause(seconds=6.0)),
    )


def _other_places(force_n: float) -> RecordingProtocol:
    order = [_MANY[number * _STEP % len(_MANY)] for number in range(len(_MANY))]
    return RecordingProtocol(
        name="other places",
        about="Press twelve places all over the skin in mixed order, each as strongly, again and again.",
        repeat=4,
        steps=tuple(Press(place=place, force_n=force_n, hold_s=0.5) for place in order),
    )


def _rising_force(force_n: float) -> RecordingProtocol:
    return RecordingProtocol(
        name="rising force",
        about="Press the same places with a tenth, a third, two thirds and all of the force.",
        repeat=4,
        steps=tuple(
            Press(place=place, force_n=share * force_n, hold_s=0.7)
            for place in _THREE
            for share in (0.1, 0.33, 0.67, 1.0)
        ),
    )


def _turned_finger(force_n: float) -> RecordingProtocol:
    presses = tuple(
        Press(place=place, force_n=force_n, hold_s=0.5, shear=shear)
        for place in (_UNDERSIDE, _TIP)
        for shear in _SHEARS
    )
    steps: list[Step] = []
    for turn in _TURNS:
        steps += [Turn(degrees=turn), *presses]
    return RecordingProtocol(
        name="turned finger",
        about="Press, and push along the skin in four directions; turn the finger about its long axis, and "
        "do it again.",
        repeat=2,
        steps=tuple(steps),
    )


def _warm_up(force_n: float) -> RecordingProtocol:
    presses = tuple(Press(place=place, force_n=force_n) for place in (*_THREE, *_THREE))
    return RecordingProtocol(
        name="cooling and warm-up",
        about="Press some places; switch the finger off for ten minutes and on again; press them again; "
        "wait ten minutes, and so on.",
        on_for_s=_HALF_WARM_S,
        repeat=5,
        steps=(*presses, SwitchOff(seconds=_SWING_S), *presses, WarmUp(seconds=_SWING_S)),
    )
