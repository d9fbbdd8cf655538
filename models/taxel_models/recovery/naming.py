"""What the benchmark asks the loop: one function. Whatever replaces the inference is called here."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from taxel.channels import COUNTS_MAX
from taxel.held_out_residual import HeldOutResidual
from taxel_models.loop.blocks import cut
from taxel_models.loop.channel_history import SensitivityChange
from taxel_models.loop.effects.registry import candidates
from taxel_models.loop.inference.constants import DECLARED, Constants
from taxel_models.loop.inference.selection import JointSelection
from taxel_models.loop.observations import gather
from taxel_models.loop.pipeline import LoopSettings, run_loop
from taxel_models.model import Model
from taxel_models.recordings import Recording

CLEANINGS: Final = 5


@dataclass(frozen=True)
class Naming:
    """What the loop says of a recording.

    Attributes:
        names: of the causes, in order.
        instead: names that it cannot tell from one of those.
        structured: what is left has structure.
        parameters: by `name.parameter`.
        served: a corrected model can have all causes.
        evaluation: (n,) rows of windows that nothing was fitted to.
        before: normalised MAE on these rows.
        after: with the correction.
        changed: channels of which a line says that their sensitivity changed.
    """

    names: tuple[str, ...]
    instead: tuple[str, ...]
    structured: bool
    parameters: Mapping[str, float]
    served: bool
    evaluation: NDArray[np.bool_]
    before: float
    after: float
    changed: tuple[str, ...]


def name_causes(
    model: Model,
    recording: Recording,
    seed: int,
    reference: HeldOutResidual | None = None,
    constants: Constants = DECLARED,
) -> Naming:
    """The loop's answer for one recording.

    Args:
        seed: of its random draws.
        reference: the model's own held-out residual; None where its manifest knows that, or nobody does.
        constants: of the inference.
    """
    settings = LoopSettings(seed=seed, least_share=constants.least_share, constants=constants)
    result = run_loop(model, [recording], settings, reference=reference)
    findings = result.findings
    return Naming(
        names=tuple(effect.name for effect in findings.effects),
        instead=tuple(sorted({name for effect in findings.effects for name in effect.confounded_with})),
        structured=findings.unexplained.structured,
        parameters={
            f"{effect.name}.{figure.name}": figure.value
            for effect in findings.effects
            for figure in effect.parameters
        },
        served=all(effect.served for effect in findings.effects),
        evaluation=result.blocks.evaluation,
        before=findings.before["norm_mae"],
        after=findings.after["norm_mae"],
        # A reading also changes with a drift: that is no sensitivity.
        changed=tuple(change.channel for change in result.changes if isinstance(change, SensitivityChange)),
    )


def without_effects(model: Model, recording: Recording, seed: int) -> Recording:
    """A recording without the effects that the loop finds before any injection.

    Effects of a quarter of the naming threshold are taken out, too, and each time they are looked for in
    another split, so that yet another one names none.
    """
    recording = recording.ticks()
    for cleaning in range(CLEANINGS):
        observations = gather(model, [recording])
        blocks = cut(observations, seed=seed + cleaning)
        selection = JointSelection(
            observations,
            blocks,
            candidates(observations),
            constants=replace(DECLARED, least_share=DECLARED.least_share / 4),
        )
        named = selection.run().named
        if not named:
            break
        channels = recording.channels.copy()
        channels[observations.rows[0]] -= sum(effect.contribution for effect in named)
        recording = replace(recording, channels=np.clip(np.rint(channels), 0, COUNTS_MAX))
    return recording
