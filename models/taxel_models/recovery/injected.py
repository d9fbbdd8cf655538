"""What a round injects: nothing, one cause or two, from the own injectors or the foreign ones."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, Literal

import numpy as np

from taxel.errors import SettingsError
from taxel_models.foreign.injection import ForeignInjection
from taxel_models.foreign.registry import INJECTORS, Injector
from taxel_models.foreign.registry import UNKNOWN as FOREIGN_UNKNOWN
from taxel_models.ground.ground import Clean, Floats, predicted
from taxel_models.loop.effects.fault import Fault
from taxel_models.loop.effects.registry import NAMES
from taxel_models.recordings import Recording
from taxel_models.recovery.injection import Injection
from taxel_models.recovery.injectors import inject
from taxel_models.recovery.rounds import BOTH, NONE, UNKNOWN_KIND
from taxel_models.recovery.unknown import UNKNOWN

InjectorKind = Literal["own", "foreign"]
RoundKind = Literal["clean", "unknown", "named"]

CLEAN_SHARE: Final = 0.2
UNKNOWN_SHARE: Final = 0.1
STRENGTHS: Final = (0.5, 2.0)
"""The least and greatest strength over the residual; strengths are drawn evenly in the logarithm."""


@dataclass(frozen=True)
class Draw:
    """What may be injected.

    Attributes:
        injector: which set of injectors.
        effects: names that may be drawn, of effects or of foreign causes; all if there are none.
        strengths: least and greatest.
        pairs: two causes in each round that has one with a name.
        clean_share: rounds without a cause.
        unknown_share: rounds with a cause that no effect describes, as far as others are left.
    """

    injector: InjectorKind = "own"
    effects: tuple[str, ...] = ()
    strengths: tuple[float, float] = STRENGTHS
    pairs: bool = False
    clean_share: float = CLEAN_SHARE
    unknown_share: float = UNKNOWN_SHARE

    def __post_init__(self) -> None:
        least, greatest = self.strengths
        if not 0 < least <= greatest:
            raise SettingsError(
                f"strengths {least:g} to {greatest:g}: expected two above 0, the least first"
            )
        if unknown := [name for name in self.effects if name not in self.known]:
            known = ", ".join(sorted(self.known))
            raise SettingsError(f"no cause {', '.join(unknown)}: expected one of {known}")

    @property
    def known(self) -> set[str]:
        """Every name that may be drawn."""
        if self.injector == "own":
            return set(NAMES)
        return {name for injector in INJECTORS for name in (injector.name, injector.cause)}

    def kind(self, random: np.random.Generator) -> tuple[RoundKind, float]:
        """Whether a round is clean, `unknown` or `named`, and its strength."""
        least, greatest = np.log(self.strengths)
        strength = float(np.exp(random.uniform(least, greatest)))
        dice = float(random.random())
        if dice < self.clean_share:
            return "clean", 0.0
        return ("unknown" if dice < self.clean_share + self.unknown_share else "named"), strength


@dataclass(frozen=True)
class Injected:
    """A recording with what was injected into it.

    Attributes:
        truth: as in `Round`.
        strength: of each cause over the residual.
        recording: the loop sees it and nothing else.
        parameters: of what was injected; by the causes' names if there are two.
        accepted: the names that are right, for each cause.
    """

    truth: str
    strength: float
    recording: Recording
    parameters: dict[str, Any]
    accepted: tuple[tuple[str, ...], ...]


def inject_drawn(clean: Clean, residual: Floats, draw: Draw, random: np.random.Generator) -> Injected:
    """Draw causes and inject them.

    Args:
        residual: (n, 21) of the clean recording, counts.
    """
    kind, strength = draw.kind(random)
    if draw.injector == "foreign":
        return _foreign(clean, residual, draw, random, kind, strength)
    return _own(clean, residual, draw, random, kind, strength)


def _own(
    clean: Clean,
    residual: Floats,
    draw: Draw,
    random: np.random.Generator,
    kind: RoundKind,
    strength: float,
) -> Injected:
    truths: list[str] = []
    if kind == "unknown":
        truths = [f"{UNKNOWN_KIND}{random.choice(sorted(UNKNOWN))}"]
    elif kind == "named":
        possible = [name for name in draw.effects or NAMES if _can_be_injected(name, clean)]
        for _ in range(2 if draw.pairs else 1):
            _require_any(possible, draw)
            truths.append(str(random.choice(possible)))
            possible = [name for name in possible if name != truths[-1]]
    size = np.sqrt((residual**2).mean(axis=0))
    injection = Injection.into(clean.recording, int(random.integers(1 << 30)), size)
    injection.respond = _responding(clean)
    for truth in truths:
        inject_truth(injection, truth, strength)
    found = {one["name"]: one.get("parameters", {}) for one in injection.truth}
    parameters = next(iter(found.values())) if len(found) == 1 else found
    accepted = tuple((truth,) for truth in truths if not truth.startswith(UNKNOWN_KIND))
    return Injected(BOTH.join(truths) or NONE, strength, injection.recording, parameters, accepted)


def _can_be_injected(name: str, clean: Clean) -> bool:
    if name == "location":
        return clean.on_skin
    return name != "temperature" or float(clean.recording.auxiliary["tdc"].std()) > 0


def inject_truth(injection: Injection, truth: str, strength: float) -> None:
    """Put an effect, or a cause that no effect describes, into a recording."""
    if truth.startswith(UNKNOWN_KIND):
        injection.begin(truth, strength)
        UNKNOWN[truth.removeprefix(UNKNOWN_KIND)](injection)
    else:
        inject(injection, truth, strength)


def _foreign(
    clean: Clean,
    residual: Floats,
    draw: Draw,
    random: np.random.Generator,
    kind: RoundKind,
    strength: float,
) -> Injected:
    injection = ForeignInjection(
        clean.recording,
        random,
        residual.std(axis=0),
        clean.contact,
        np.array(clean.live),
        clean.on_skin,
        _responding(clean),
        strength,
    )
    drawn = _drawn(injection, draw, kind)
    parameters: dict[str, Any] = {}
    # What an electrode reports while it is stuck, or frames that are dropped, no other cause changes.
    for injector in sorted(drawn, key=lambda one: Fault.name in one.right):
        injection.parameters = parameters.setdefault(injector.name, {})
        injector.inject(injection)
    return Injected(
        BOTH.join(injector.name for injector in drawn) or NONE,
        strength,
        injection.recording,
        next(iter(parameters.values())) if len(drawn) == 1 else parameters,
        tuple(injector.right for injector in drawn if injector.right),
    )


def _drawn(injection: ForeignInjection, draw: Draw, kind: RoundKind) -> list[Injector]:
    """A cause first, then its form, so that a cause of many forms is not drawn more often."""
    if kind == "clean":
        return []
    wanted: tuple[Injector, ...] = FOREIGN_UNKNOWN
    if kind == "named":
        names = draw.effects or draw.known
        wanted = tuple(one for one in INJECTORS if one.name in names or one.cause in names)
    possible = [injector for injector in wanted if injector.fits(injection)]
    drawn: list[Injector] = []
    for _ in range(2 if draw.pairs and kind == "named" else 1):
        _require_any(possible, draw)
        causes = sorted({injector.cause for injector in possible})
        cause = str(injection.random.choice(causes))
        forms = [injector for injector in possible if injector.cause == cause]
        drawn.append(forms[int(injection.random.integers(len(forms)))])
        # Two causes with a name in common could not both be told.
        possible = [one for one in possible if not set(one.right) & set(drawn[-1].right)]
    return drawn


def _require_any(possible: Sequence[object], draw: Draw) -> None:
    if not possible:
        names = ", ".join(draw.effects) or "all causes"
        raise SettingsError(
            f"{names}: no cause, or no second one, fits this ground; expected other names, or more of them"
        )


def _responding(clean: Clean) -> Callable[[Floats, Floats], Floats]:
    """What the model gives for other inputs, at every tick; 0 where a tick has no whole window."""

    def respond(position: Floats, force: Floats) -> Floats:
        samples = replace(clean.recording.samples, position=position, force=force)
        found, rows = predicted(clean.model, replace(clean.recording, samples=samples))
        counts = np.zeros((len(clean.recording), found.shape[1]))
        counts[rows] = found
        return counts

    return respond
