"""What a rehearsal takes from the recordings at hand."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from taxel.channels import CHANNELS
from taxel.held_out_residual import CorrelatedResidual, HeldOutResidual
from taxel_models.loop.basis import Own
from taxel_models.loop.blocks import cut
from taxel_models.loop.effects.effect import Candidate, Fitting, Online
from taxel_models.loop.inference.constants import DECLARED
from taxel_models.loop.next_recording.fitted import Fitted
from taxel_models.loop.next_recording.rehearsal import Stage
from taxel_models.loop.observations import Observations

SAME = (0.2,) * len(CHANNELS)
REFERENCE = HeldOutResidual(
    rows=900,
    std=(3.0,) * len(CHANNELS),
    shared=SAME,
    fading=SAME,
    correlated=CorrelatedResidual(
        precision=tuple(map(tuple, np.eye(len(CHANNELS)).tolist())), shared=SAME, fading=SAME, structure={}
    ),
)


@pytest.fixture(scope="module")
def stage(observations: Observations) -> Stage:
    return Stage(observations, cut(observations, seed=0), observations.residual, REFERENCE, DECLARED)


def cause(*, few_channels: bool) -> Fitted:
    regressor = Own(np.zeros((1, len(CHANNELS), 1), np.float32))
    fitting = Fitting(few_channels=few_channels)
    candidate = Candidate("gain", "by channel", regressor, fitting=fitting, online=lambda _: Online())
    return Fitted(candidate, np.ones((len(CHANNELS), 1)))


@pytest.mark.parametrize("few", [(False, True), (True, False), (True, True)])
def test_a_change_of_few_channels_is_judged_beside_all_others(stage: Stage, few: Any) -> None:
    causes = [cause(few_channels=each) for each in few]
    assert stage.reference_for(causes) == REFERENCE


def test_changes_of_many_channels_keep_all_else_that_is_known(stage: Stage) -> None:
    found = stage.reference_for([cause(few_channels=False), cause(few_channels=False)])
    assert found == REFERENCE.model_copy(update={"correlated": None})


def test_without_a_reference_there_is_none(stage: Stage) -> None:
    assert replace(stage, reference=None).reference_for([cause(few_channels=False)]) is None
