"""A rehearsal: the loop on simulated recordings of a protocol, each with a cause that is known."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from taxel.channels import COUNTS_MAX
from taxel.held_out_residual import HeldOutResidual
from taxel.windows.history import TOUCH_N
from taxel_models.loop.attribution import Attribution
from taxel_models.loop.basis import Floats
from taxel_models.loop.blocks import Blocks, cut
from taxel_models.loop.effects.location import Location
from taxel_models.loop.effects.offset import Offset
from taxel_models.loop.effects.registry import effect_named
from taxel_models.loop.effects.temperature import TDC
from taxel_models.loop.inference.constants import Constants
from taxel_models.loop.inference.selection import JointSelection
from taxel_models.loop.next_recording.fitted import Fitted
from taxel_models.loop.observations import Observations, gather
from taxel_models.recordings import Recording
from taxel_models.twin import perform
from taxel_models.twin.protocol import RecordingProtocol
from taxel_models.twin.temperature import core_celsius, on_for, tdc_counts

DRAWS: Final = 5
"""Simulated recordings with each of the two causes."""

SIMULATED: Final = 2 * DRAWS


@dataclass(frozen=True)
class Stage:
    """What a rehearsal takes from the recordings at hand.

    Attributes:
        observations: of the recordings at hand, with their inputs put right.
        blocks: theirs.
        left: (n, 21) what no named effect explains, counts: the noise.
        reference: the model's own held-out residual; None if it is not known.
        constants: of the inference.
    """

    observations: Observations
    blocks: Blocks
    left: Floats
    reference: HeldOutResidual | None
    constants: Constants

    def reference_for(self, causes: Sequence[Fitted]) -> HeldOutResidual | None:
        """The reference, with its correlated channels only if a cause changes few channels.

        To judge few channels beside all others takes most of the time of a decision.
        """
        if self.reference is None or any(cause.candidate.fitting.few_channels for cause in causes):
            return self.reference
        return self.reference.model_copy(update={"correlated": None})

    def noise(self, rows: int, random: np.random.Generator) -> Floats:
        """(rows, 21) counts: whole blocks of what is left, drawn at random (Künsch 1989)."""
        parts, length = [], 0
        while length < rows:
            block = self.left[self.blocks.of_row == random.integers(len(self.blocks))]
            parts.append(block)
            length += len(block)
        return np.concatenate(parts)[:rows]

    def placed(self, recording: Recording) -> Recording:
        """The recording on this finger's scale of temperature; at one pose where positions are poses."""
        tdc = self.observations.covariates.get(TDC)
        if tdc is not None:
            # A finger that is warmer or colder than the twin ever is stays so.
            usual = core_celsius(1, np.zeros(1), on_for(float(tdc.mean())))
            warmer = float(tdc.mean() - tdc_counts(usual)[0])
            shifted = recording.auxiliary[TDC] + warmer
            recording = replace(recording, auxiliary={**recording.auxiliary, TDC: shifted})
        if Location().out_of_scope(self.observations) is None:
            return recording
        touched = np.flatnonzero(self.observations.pressed > TOUCH_N)
        position = np.median(self.observations.position[touched], axis=0)
        direction = self.observations.force[touched].mean(axis=0)
        direction /= max(float(np.linalg.norm(direction)), 1e-9)
        samples = recording.samples
        force = np.linalg.norm(samples.force, axis=1)[:, None] * direction
        positions = np.broadcast_to(position, force.shape).copy()
        return replace(recording, samples=replace(samples, position=positions, force=force))


def rehearse(
    stage: Stage, protocol: RecordingProtocol, causes: tuple[Fitted, Fitted], *, must_exceed: int
) -> int | None:
    """Simulate recordings of a protocol, each with one of two causes, and let the loop decide.

    The effects that compete are these two and a constant.

    Args:
        must_exceed: with no more right decisions than these it gives up.

    Returns:
        In how many of them the loop named the cause that was there and took it for the only explanation;
        None if it gave up.
    """
    random = np.random.default_rng(0)
    right, left = 0, SIMULATED
    for _ in range(DRAWS):
        recording = stage.placed(perform(protocol, int(random.integers(1 << 31))))
        observations = gather(stage.observations.model, [recording], withheld=stage.observations.withheld)
        blocks = cut(observations, seed=0)
        for cause in causes:
            counts = cause.counts(observations) + stage.noise(len(observations), random)
            measured = np.clip(np.rint(counts), 0, COUNTS_MAX)
            found = _found(stage, replace(observations, measured=measured), blocks, causes)
            others = {other.name for other in causes} - {cause.name}
            right += _decides(found, cause.name, others)
            left -= 1
            if right + left <= must_exceed:
                return None
    return right


def _found(
    stage: Stage, observations: Observations, blocks: Blocks, causes: Sequence[Fitted]
) -> Attribution:
    names = dict.fromkeys([*(cause.name for cause in causes), Offset.name])
    effects = [effect_named(name) for name in names]
    reference = stage.reference_for(causes)
    return JointSelection(
        observations, blocks, effects, reference=reference, constants=stage.constants
    ).run()


def _decides(found: Attribution, truth: str, others: set[str]) -> bool:
    """Whether the truth was named, no other one was, and none could stand for it."""
    named = {one.name: set(one.confounded_with) for one in found.named}
    return truth in named and not others & (named.keys() | named[truth])
