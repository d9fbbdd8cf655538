"""The recovery benchmark: injects causes; the loop must find them without knowing which they are."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from typing import Final, Self

import numpy as np
from threadpoolctl import threadpool_limits

from taxel.held_out_residual import HeldOutResidual
from taxel_models.evaluation.metrics import ErrorMetrics
from taxel_models.ground.ground import Clean, Ground, predicted
from taxel_models.loop.inference.constants import DECLARED, Constants
from taxel_models.loop.reference.held_out import held_out_residual
from taxel_models.recovery.injected import Draw, Injected, inject_drawn
from taxel_models.recovery.naming import Naming, name_causes
from taxel_models.recovery.rounds import NONE, UNEXPLAINED, Round

WORTH_REMOVING: Final = 0.02
"""The least share of the error that the truth itself must remove for that share to be marked."""

FIGURES: Final = {"creep": "time_constant", "lag": "lag", "frame": "angle"}
"""Parameters that are marked: time constants, delays, angles."""


@dataclass(frozen=True)
class RecoveryBenchmark:
    """Rounds on a ground. Each follows from its number alone, so they can be played anywhere.

    Attributes:
        ground: gives the clean recordings.
        ground_name: `twin`, `slide` or `lasa`.
        seed: of causes, strengths and parameters.
        draw: what may be injected.
        constants: of the inference.
    """

    ground: Ground
    ground_name: str = "twin"
    seed: int = 0
    draw: Draw = field(default_factory=Draw)
    constants: Constants = DECLARED
    _references: dict[str, HeldOutResidual | None] = field(default_factory=dict, repr=False)

    def play(self, number: int) -> Round:
        """One round."""
        random = np.random.default_rng([self.seed, number])
        # More threads could change the last digits of a sum.
        with threadpool_limits(1):
            clean = self.ground.clean(number)
            reference = self._reference(clean)
            played = run_round(clean, self.draw, number, random, reference, self.constants)
        return played.model_copy(update={"ground": self.ground_name, "injector": self.draw.injector})

    def with_constants(self, constants: Constants) -> Self:
        """The same rounds, inferred with other constants."""
        return replace(self, constants=constants, _references={})

    def _reference(self, clean: Clean) -> HeldOutResidual | None:
        """The held-out residual of the round's model, found once for each recording of it."""
        if clean.reference is None:
            return None
        name = clean.reference.fingerprint
        if name not in self._references:
            fitted = [] if clean.fitted is None else [clean.fitted]
            self._references[name] = held_out_residual(
                clean.model, [clean.reference], fitted, self.constants
            )
        return self._references[name]


def run_rounds(benchmark: RecoveryBenchmark, rounds: int) -> Iterator[Round]:
    """Round after round: the loop sees a recording and nothing else."""
    return map(benchmark.play, range(rounds))


def run_round(
    clean: Clean,
    draw: Draw,
    number: int,
    random: np.random.Generator,
    reference: HeldOutResidual | None = None,
    constants: Constants = DECLARED,
) -> Round:
    """Injects causes, runs the loop and marks the result."""
    counts, ticks = predicted(clean.model, clean.recording)
    measured = clean.recording.channels[ticks]
    injected = inject_drawn(clean, measured - counts, draw, random)
    naming = name_causes(clean.model, injected.recording, number, reference, constants)
    rows = naming.evaluation
    output_std = clean.model.manifest.normalisation.output_std
    errors = ErrorMetrics.of(measured[rows], counts[rows], output_std)
    return _marked(number, injected, errors.norm_mae, naming, clean.base_model)


def _marked(number: int, injected: Injected, clean: float, naming: Naming, base_model: int) -> Round:
    left = UNEXPLAINED if naming.structured else NONE
    found = naming.names[0] if naming.names else left
    accepted = set().union(*injected.accepted)
    removable = naming.before - clean
    worth_marking = removable > WORTH_REMOVING * naming.before and naming.served
    return Round(
        number=number,
        truth=injected.truth,
        strength=injected.strength,
        injected=injected.parameters,
        found=found,
        named=naming.names,
        right=found in accepted if accepted else not naming.names,
        confounded=bool(accepted & set(naming.instead)),
        clean=clean,
        before=naming.before,
        after=naming.after,
        removed=(naming.before - naming.after) / removable if worth_marking else None,
        parameter_error=_parameter_error(injected, naming),
        accepted=injected.accepted,
        all_named=bool(accepted) and all_named(injected.accepted, naming.names),
        changed=naming.changed,
        base_model=base_model,
    )


def all_named(accepted: Sequence[Sequence[str]], named: Sequence[str]) -> bool:
    """Whether each cause has a right name among those named, and no two share one."""
    choices = product(*([name for name in right if name in named] for right in accepted))
    return any(len(set(choice)) == len(choice) for choice in choices)


def _parameter_error(injected: Injected, naming: Naming) -> float | None:
    """For a single effect of the own injectors, which have the loop's parameters."""
    figure = FIGURES.get(injected.truth)
    if figure is None or figure not in injected.parameters:
        return None
    true = float(injected.parameters[figure])
    found = naming.parameters.get(f"{injected.truth}.{figure}")
    return None if found is None else abs(found - true) / abs(true)
