"""Stability: how often effects are named on random halves of the blocks (Shah and Samworth 2013)."""

from collections import Counter
from collections.abc import Sequence

import numpy as np

from taxel.held_out_residual import HeldOutResidual
from taxel_models.loop.attribution import Attribution
from taxel_models.loop.blocks import Blocks
from taxel_models.loop.effects.effect import Effect
from taxel_models.loop.findings import Stability
from taxel_models.loop.inference.constants import Constants
from taxel_models.loop.inference.selection import JointSelection
from taxel_models.loop.observations import Observations
from taxel_models.loop.status import StatusCallback


def on_halves(
    observations: Observations,
    blocks: Blocks,
    effects: Sequence[Effect],
    whole: Attribution,
    halves: int,
    *,
    seed: int,
    reference: HeldOutResidual | None,
    constants: Constants,
    progress: StatusCallback,
) -> Stability:
    """Name effects anew on each half, and count.

    Args:
        observations: the recordings with the model's predictions.
        blocks: the fit part is halved.
        effects: that compete on the whole fit part.
        whole: what was named there. To save time, halves try no effect that had no form there or that
            explained nothing, nor unnamed ones whose forms take many predictions.
        halves: how many; every second one is the other half of the one before.
        seed: of the halves.
        reference: the model's own held-out residual; None if it is not known.
        constants: of the inference.
        progress: is told which half is looked at.
    """
    named = {one.name for one in whole.named}
    likely = {one.name for one in whole.rejected if one.alone > 0 or one.log_evidence > 0}
    able = [
        effect
        for effect in effects
        if effect.label in named or (effect.label in likely and not effect.is_costly)
    ]
    chosen: Counter[str] = Counter()
    for number, half in enumerate(halved(blocks, halves, seed), 1):
        progress(f"half {number} of {halves}")
        found = JointSelection(observations, half, able, reference=reference, constants=constants).run()
        chosen.update(named.name for named in found.named)
    return Stability(halves=halves, chosen={name: count / halves for name, count in chosen.most_common()})


def halved(blocks: Blocks, count: int, seed: int) -> list[Blocks]:
    """Complementary halves of the fit part's blocks, each with folds of its own, as they were."""
    generator = np.random.default_rng(seed)
    fit = np.flatnonzero(blocks.fold >= 0)
    found: list[Blocks] = []
    while len(found) < count:
        order = generator.permutation(fit)
        for some in np.array_split(order, 2):
            fold = np.full(len(blocks), -1)
            fold[some] = np.unique(blocks.fold[some], return_inverse=True)[1]
            found.append(Blocks(blocks.of_row, fold))
    return found[:count]
