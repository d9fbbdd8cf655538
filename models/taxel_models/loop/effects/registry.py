"""The list of effects.

To add an effect, write its file, add its class here, and its injector in `recovery/injectors.py`.
"""

from typing import Final

from taxel.errors import SettingsError
from taxel_models.loop.effects.covariate import Covariate
from taxel_models.loop.effects.creep import Creep
from taxel_models.loop.effects.crosstalk import Crosstalk
from taxel_models.loop.effects.drift import Drift
from taxel_models.loop.effects.effect import Effect
from taxel_models.loop.effects.fault import Fault
from taxel_models.loop.effects.frame import FrameEffect
from taxel_models.loop.effects.gain import Gain
from taxel_models.loop.effects.hysteresis import Hysteresis
from taxel_models.loop.effects.interference import Interference
from taxel_models.loop.effects.lag import Lag
from taxel_models.loop.effects.load import Load
from taxel_models.loop.effects.location import Location
from taxel_models.loop.effects.offset import Offset
from taxel_models.loop.effects.rate import Rate
from taxel_models.loop.effects.saturation import Saturation
from taxel_models.loop.effects.temperature import Temperature
from taxel_models.loop.observations import Observations
from taxel_models.recordings.kinds import NOT_COVARIATES

EFFECTS: Final[tuple[type[Effect], ...]] = (
    Offset,
    Gain,
    Load,
    Drift,
    Temperature,
    Creep,
    Hysteresis,
    Rate,
    Lag,
    FrameEffect,
    Location,
    Crosstalk,
    Saturation,
    Fault,
    Interference,
)
"""Every effect that needs no extra column, the simplest first."""

NAMES: Final = tuple(effect.name for effect in EFFECTS)


def candidates(observations: Observations) -> list[Effect]:
    """Every effect that a recording could show. Each extra column has one."""
    columns = [name for name in observations.covariates if name not in NOT_COVARIATES]
    return [*(effect() for effect in EFFECTS), *map(Covariate, columns)]


def effect_named(name: str) -> Effect:
    """An effect by its name, such as `creep` or `covariate:material`.

    Raises:
        SettingsError: there is no effect of this name.
    """
    kind, _, column = name.partition(":")
    if kind == Covariate.name and column:
        return Covariate(column)
    for effect in EFFECTS:
        if effect.name == name:
            return effect()
    raise SettingsError(f"no effect {name!r}: expected one of {', '.join(NAMES)}, or covariate:COLUMN")


def why_only_reported(name: str, form: str) -> str:
    """Why no model is served with a form of a named effect, and what to do about it."""
    kinds = (effect for effect in EFFECTS if effect.name == name)
    return next(kinds, Effect).why_only_reported(form)
