"""Why an effect was not named: what the report gives as the reason is the one that decided."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from taxel_models.loop.attribution import AS_USUAL
from taxel_models.loop.blocks import cut
from taxel_models.loop.effects.effect import Fitting
from taxel_models.loop.inference.constants import DECLARED
from taxel_models.loop.inference.outcome import DOUBTED, Outcome
from taxel_models.loop.observations import Observations

TOO_LITTLE = "takes too little off the error to matter"
UNSURE = "not sure enough for how little it takes off the error"


def score(worth: float, t: float, *, predictable: bool = True, rows: bool = False, worse: int = 0) -> Any:
    """An effect that removes a share of the error, with so much certainty."""
    effect = SimpleNamespace(
        is_predictable=predictable,
        fits_nothing=False,
        is_constant=False,
        is_of_one_channel=False,
        raises_rows=rows,
    )
    return SimpleNamespace(
        name="creep",
        effect=effect,
        form=SimpleNamespace(candidate=SimpleNamespace(fitting=Fitting(), form="by force")),
        weighed=SimpleNamespace(changes=np.ones(21, np.bool_)),
        log_evidence=100.0,
        p_value=0.001,
        chance=1.0,
        folds=20,
        t=t,
        t_with_usual=t,
        channel_t=np.zeros(21),
        worth=np.full(21, worth),
        gain=np.where(np.arange(20)[:, None] < worse, -3.0, 1.0) * np.ones(21),
        usual=np.full((20, 21), 2.0),
    )


@pytest.mark.parametrize(
    ("found", "reason"),
    [
        (score(0.7, 6.0), DOUBTED),
        (score(0.7, 6.0, rows=True), "single rows are further off with it"),
        (score(-0.6, 6.0), "held-out blocks are further off with it"),
        (score(0.01, 6.0), TOO_LITTLE),
        (score(0.04, 2.6), UNSURE),
        (score(0.3, 6.0, predictable=False), DOUBTED),
        (score(0.3, 6.0, predictable=False, worse=10), AS_USUAL),
        (score(0.01, 6.0, predictable=False), TOO_LITTLE),
        (score(0.7, 1.0), "does not repeat over the held-out folds: few of them show most of it"),
        (
            score(0.7, 1.0, worse=6),
            "does not repeat over the held-out folds: 6 of 20 are further off with it",
        ),
    ],
)
def test_the_reason_is_what_decided(observations: Observations, found: Any, reason: str) -> None:
    scoring: Any = SimpleNamespace(
        constants=DECLARED,
        out_of_scope={},
        contradicts=lambda score, taken: False,
        raises_single_rows=lambda score, taken: score.effect.raises_rows,
    )
    outcome = Outcome(observations, cut(observations, seed=0), scoring)
    (rejected,) = outcome.rejected([found], [found], [], [])
    assert rejected.reason == reason
