"""The evaluation part: what each named effect adds where nothing was fitted to, and the paired test."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from taxel.corrections import Parameter
from taxel_models.loop.attribution import Attribution, Named
from taxel_models.loop.basis import Floats
from taxel_models.loop.blocks import Blocks
from taxel_models.loop.correction import NewEffects
from taxel_models.loop.findings import FoundEffect, PairedTest
from taxel_models.loop.observations import Observations


def found_effects(
    observations: Observations,
    attribution: Attribution,
    figures: Mapping[str, list[Parameter]],
    new: NewEffects,
    rows: NDArray[np.bool_],
) -> tuple[FoundEffect, ...]:
    """Named effects in their order, with what each adds to those before it on the evaluation part."""
    measured, counts = observations.measured[rows], observations.predicted[rows]
    left = measured - counts
    first = np.maximum((left**2).mean(axis=0), 1e-9)
    served = {effect.name: effect for effect in new.effects}
    found = []
    for named in attribution.named:
        counts = counts + named.contribution[rows]
        left_after = measured - counts + observations.limits.beyond(measured, counts)
        explained = float((((left**2).mean(axis=0) - (left_after**2).mean(axis=0)) / first).mean())
        left = left_after
        applied = served.get(named.name)
        needs = (
            [] if applied is None else [extra.name for extra in new.extras if extra.name in applied.takes]
        )
        found.append(_found_effect(named, explained, figures[named.name], needs, applied is not None))
    return tuple(found)


def _found_effect(
    named: Named, explained: float, figures: Sequence[Parameter], needs: Sequence[str], served: bool
) -> FoundEffect:
    return FoundEffect(
        name=named.name,
        form=named.candidate.form,
        equation=named.equation,
        channels=named.channels,
        explained=explained,
        conditional=named.conditional,
        p_value=named.p_value,
        log_evidence=named.log_evidence,
        parameters=tuple(figures),
        confounded_with=named.confounded_with,
        needs=tuple(needs),
        served=served,
    )


def paired_test(
    observations: Observations, blocks: Blocks, after: Floats, output_std: Floats
) -> PairedTest:
    """Whether the corrected model errs less than the first, block by block."""
    rows = blocks.evaluation
    fall = np.abs(observations.residual) - np.abs(observations.measured - after)
    by_row = (fall / output_std).mean(axis=1)
    numbers = np.unique(blocks.of_row[rows])
    falls = np.array([by_row[blocks.of_row == number].mean() for number in numbers])
    if not falls.std() > 0:
        # If the error of all blocks falls by the same amount, the test is not defined.
        mean = float(falls.mean())
        return PairedTest(blocks=len(falls), difference=mean, low=mean, high=mean, t=0.0, p_value=0.5)
    interval = stats.ttest_1samp(falls, 0.0).confidence_interval(0.95)
    test = stats.ttest_1samp(falls, 0.0, alternative="greater")
    return PairedTest(
        blocks=len(falls),
        difference=float(falls.mean()),
        low=float(interval.low),
        high=float(interval.high),
        t=float(test.statistic),
        p_value=float(test.pvalue),
    )
