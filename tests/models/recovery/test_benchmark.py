"""Rounds are counted as they should be."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from taxel_models.loop.stepwise import StepwiseSelection

from taxel_models.loop.blocks import cut
from taxel_models.loop.effects.registry import NAMES, candidates
from taxel_models.loop.observations import gather
from taxel_models.recordings import Recording
from taxel_models.recovery.benchmark import (
    RecoverySettings,
    Round,
    _draw,
    run_round,
    summarise,
    without_effects,
)
from taxel_models.recovery.injection import Injection
from taxel_models.recovery.injectors import inject

Make = Callable[..., Recording]


def made(truth: str, found: str, **others: Any) -> Round:
    named = () if found in ("none", "unexplained") else (found,)
    values: dict[str, Any] = {
        "number": 0,
        "truth": truth,
        "strength": 1.0,
        "injected": {},
        "found": found,
        "named": named,
        "right": found == truth if truth in NAMES else not named,
        "confounded": False,
        "clean": 0.1,
        "before": 0.2,
        "after": 0.1,
        "removed": None,
        "parameter_error": None,
    }
    return Round(**{**values, **others})


def test_rounds_are_counted() -> None:
    summary = summarise(
        [
            made("creep", "creep", removed=0.9, before=0.2, after=0.11, parameter_error=0.1),
            made("creep", "creep", removed=0.5, before=0.5, after=0.3, parameter_error=0.3),
            made("creep", "rate", confounded=True, removed=0.1, parameter_error=0.9),
            made("lag", "none"),
            made("none", "none"),
            made("none", "unexplained"),
            made("none", "gain"),
            made("none", "none"),
            made("unknown:hum", "unexplained"),
            made("unknown:hum", "drift"),
            made("unknown:bursts", "none"),
        ]
    )
    assert summary.rounds == 11
    assert summary.confusion == {
        "creep": {"creep": 2, "rate": 1},
        "lag": {"none": 1},
        "none": {"none": 2, "unexplained": 1, "gain": 1},
        "unknown:bursts": {"none": 1},
        "unknown:hum": {"unexplained": 1, "drift": 1},
    }
    assert summary.right_first == pytest.approx(2 / 4)
    assert summary.right_or_confounded == pytest.approx(3 / 4)
    assert summary.false_alarms == pytest.approx(1 / 4)
    assert summary.unknown_left == pytest.approx(2 / 3)
    assert summary.removed == pytest.approx(0.7)
    assert summary.removed_mean == pytest.approx((0.09 + 0.2) / (0.1 + 0.4))
    assert summary.parameters_within == pytest.approx(1 / 2)


def test_nothing_to_count_is_none() -> None:
    summary = summarise([made("none", "none")])
    assert summary.false_alarms == 0.0
    assert summary.right_first is None
    assert summary.unknown_left is None
    assert summary.removed is None
    assert summary.removed_mean is None
    assert summary.parameters_within is None
    assert summarise([]).confusion == {}


def test_rounds_are_drawn_as_the_rules_say() -> None:
    draws = [_draw(np.random.default_rng([0, number]), RecoverySettings(4000)) for number in range(4000)]
    truths = [truth for truth, _ in draws]
    strengths = [strength for truth, strength in draws if truth != "none"]
    assert np.mean([truth == "none" for truth in truths]) == pytest.approx(0.2, abs=0.02)
    assert np.mean([truth.startswith("unknown:") for truth in truths]) == pytest.approx(0.1, abs=0.02)
    assert set(truths) == {"none", "unknown:hum", "unknown:telegraph", "unknown:bursts", *NAMES}
    assert 0.5 <= min(strengths) < 0.55
    assert 1.9 < max(strengths) <= 2.0


def test_a_round_is_marked_by_what_was_injected(smooth: Any, make: Make) -> None:
    drawn, random = ("lag", 2.0), np.random.default_rng(0)
    one = run_round(smooth, make(noise=4.0), drawn, 7, random)
    assert (one.number, one.truth, one.found, one.named, one.right) == (7, "lag", "lag", ("lag",), True)
    assert one.parameter_error == pytest.approx(0.0, abs=0.01)
    assert one.clean < one.after * 1.01 < one.before
    assert one.removed == pytest.approx((one.before - one.after) / (one.before - one.clean))
    assert one.removed > 0.9


def named_in(smooth: Any, recording: Recording) -> list[str]:
    observations = gather(smooth, [recording], measured_temperature=True)
    blocks = cut(observations, seed=1)
    selection = StepwiseSelection(observations, blocks, candidates(observations), seed=1)
    return [named.name for named in selection.run().named]


def test_a_recording_without_effects_is_clean_on_another_split(smooth: Any, make: Make) -> None:
    clean = make()
    injection = Injection.into(clean, 2, np.full(21, 12.0))
    inject(injection, "offset", 1.0)
    inject(injection, "rate", 0.5)
    assert set(named_in(smooth, injection.recording)) == {"offset", "rate"}
    found = without_effects(smooth, injection.recording, seed=0)
    assert named_in(smooth, found) == []
    # What was injected is gone, and nothing else.
    change = (found.channels - clean.ticks().channels)[100:-100]
    assert np.sqrt((change**2).mean()) < 1.5


def test_an_earlier_round_is_read() -> None:
    finished = made("lag", "lag", injected={"lag": 0.05})
    kept = finished.model_dump(mode="json", by_alias=True)
    assert kept["planted"] == {"lag": 0.05}
    assert "injected" not in kept
    assert Round.model_validate(kept) == finished
