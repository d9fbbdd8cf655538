"""The injectors, and which names are right for each: written down by physics, before anything is played."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Final

import numpy as np

from taxel.errors import SettingsError
from taxel_models.foreign import electrodes, inputs, memory, signal, slow, steady, timing, unknown
from taxel_models.foreign.injection import ForeignInjection


@dataclass(frozen=True)
class Injector:
    """A foreign cause.

    Attributes:
        name: `cause: form`.
        inject: puts it into a recording.
        right: each of these names is right; none for a cause that no effect describes.
        needs: `skin` for positions on the skin, `tdc` for a temperature that changes, or a column of
            several kinds.
    """

    name: str
    inject: Callable[[ForeignInjection], None]
    right: tuple[str, ...]
    needs: str = ""

    @property
    def cause(self) -> str:
        """What precedes the form."""
        return self.name.partition(":")[0]

    def fits(self, injection: ForeignInjection) -> bool:
        """Whether a recording has what it needs."""
        if self.needs == "skin":
            return injection.on_skin
        if self.needs == "tdc":
            return float(injection.recording.auxiliary["tdc"].std()) > 0
        if not self.needs:
            return True
        # What a single kind adds is an offset or a gain.
        return len(np.unique(injection.recording.covariates.get(self.needs, ()))) > 1


INJECTORS: Final = (
    Injector("offset", steady.offset, ("offset",)),
    Injector("contact offset", steady.contact_offset, ("offset:contact",)),
    Injector("gain: all channels", steady.gain, ("gain",)),
    Injector("gain: some electrodes", steady.gain_of_electrodes, ("gain",)),
    # A sensitivity that falls is a gain that ages; a step of it is what a fault does.
    Injector("dying electrode: linear", electrodes.dying_linearly, ("gain",)),
    Injector("dying electrode: exponential", electrodes.dying_exponentially, ("gain",)),
    Injector("dying electrode: stepwise", electrodes.dying_stepwise, ("gain", "fault")),
    Injector("fault: intermittent", electrodes.intermittent, ("fault",)),
    Injector("fault: stuck", electrodes.stuck, ("fault",)),
    Injector("fault: crossed wires", electrodes.crossed, ("fault",)),
    Injector("drift: linear", slow.drift_linear, ("drift",)),
    Injector("drift: warming", slow.drift_warming, ("drift",)),
    Injector("drift: saturating", slow.drift_saturating, ("drift",)),
    Injector("drift: stepwise", slow.drift_stepwise, ("drift",)),
    Injector("temperature: measured", slow.temperature_measured, ("temperature",), "tdc"),
    Injector("temperature: by contact", slow.temperature_contact, ("temperature",), "tdc"),
    Injector("creep: power law", memory.creep_power_law, ("creep",)),
    Injector("creep: two constants", memory.creep_two_constants, ("creep",)),
    Injector("creep: relaxing", memory.creep_relaxing, ("creep",)),
    Injector("hysteresis: Bouc-Wen", memory.hysteresis_bouc_wen, ("hysteresis",)),
    # Its state fades as creep does: the equation has both.
    Injector("hysteresis: fading", memory.hysteresis_fading, ("hysteresis", "creep")),
    Injector("rate: saturating", memory.rate_saturating, ("rate",)),
    Injector("rate: root", memory.rate_root, ("rate",)),
    # The signal less its low-pass is also how a signal creeps.
    Injector("lag: first order", timing.lag_first_order, ("lag", "creep")),
    Injector("lag: delay", timing.lag_delay, ("lag",)),
    Injector("lag: jitter", timing.lag_jitter, ("lag",)),
    # A frame that is repeated is late, and a channel that repeats a value is faulty.
    Injector("lag: dropped frames", timing.dropped_frames, ("lag", "fault")),
    Injector("saturation: soft", signal.saturation, ("saturation",)),
    Injector("crosstalk: converter", signal.crosstalk, ("crosstalk",)),
    Injector("interference", signal.interference, ("interference",)),
    Injector("frame: slipped", inputs.slipped_mounting, ("frame",)),
    Injector("frame: turned", inputs.turned_mounting, ("frame",)),
    Injector("frame: force sensor's zero", inputs.force_zero, ("frame",)),
    # A finger that answers to all forces alike cannot tell a force sensor's gain from its own.
    Injector("frame: force sensor's gain", inputs.force_gain, ("frame", "gain")),
    Injector("location: Cauchy", signal.place_gain, ("location",), "skin"),
    Injector("location: patches", signal.place_patch, ("location",), "skin"),
    Injector("covariate: constant", steady.material_constant, ("covariate:material",), "material"),
    Injector("covariate: gain", steady.material_gain, ("covariate:material",), "material"),
)

UNKNOWN: Final = (
    Injector("unknown: wander", unknown.wander, ()),
    Injector("unknown: chirp", unknown.chirp, ()),
    Injector("unknown: shocks", unknown.shocks, ()),
    Injector("unknown: noise", unknown.noise, ()),
)


def injector_named(name: str) -> Injector:
    """An injector by its name.

    Raises:
        SettingsError: there is none of this name.
    """
    for injector in (*INJECTORS, *UNKNOWN):
        if injector.name == name:
            return injector
    raise SettingsError(f"no injector {name!r}: expected one of {_listed((*INJECTORS, *UNKNOWN))}")


def _listed(injectors: Iterable[Injector]) -> str:
    return ", ".join(injector.name for injector in injectors)
