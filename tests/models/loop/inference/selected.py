"""What is named in a small recording with known causes."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from taxel_models.loop.attribution import Attribution, Named
from taxel_models.loop.blocks import cut
from taxel_models.loop.effects.registry import candidates
from taxel_models.loop.inference.constants import DECLARED, Constants
from taxel_models.loop.inference.selection import JointSelection
from taxel_models.loop.observations import gather
from taxel_models.recordings import Recording
from taxel_models.recovery.injection import Injection

Make = Callable[..., Recording]
ROWS = 6_000


def into(make: Make, rows: int = ROWS, seed: int = 3) -> Injection:
    return Injection.into(make(rows, seed=seed), 2, np.full(21, 12.0))


def add(injection: Injection, delta: np.ndarray) -> None:
    """Counts (n, 21) or (n, 1), as they are."""
    counts = injection.recording.channels + delta
    injection.recording = replace(injection.recording, channels=np.clip(np.rint(counts), 0, 4095))


def attributed(
    smooth: Any, recording: Recording, constants: Constants = DECLARED, exclude: tuple[str, ...] = ()
) -> Attribution:
    observations = gather(smooth, [recording])
    effects = [effect for effect in candidates(observations) if effect.label not in exclude]
    return JointSelection(observations, cut(observations, seed=0), effects, constants=constants).run()


def names(found: Attribution) -> list[str]:
    return [one.name for one in found.named]


def only(found: Attribution) -> Named:
    (one,) = found.named
    return one
