"""Rounds are counted as they should be, with intervals, and drawn."""

from pathlib import Path
from typing import Any

import pytest

from taxel_models.foreign.registry import INJECTORS
from taxel_models.loop.effects.registry import NAMES
from taxel_models.recovery.pictures import CONFUSION, POWER, write_pictures
from taxel_models.recovery.rounds import DYING, Round, Summary, rate, summarise


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


ROUNDS = [
    made("creep", "creep", removed=0.9, before=0.2, after=0.11, parameter_error=0.1, all_named=True),
    made("creep", "creep", removed=0.5, before=0.5, after=0.3, parameter_error=0.3, strength=1.9),
    made("creep", "rate", confounded=True, removed=0.1, parameter_error=0.9),
    made("lag", "none", strength=0.5),
    made("none", "none"),
    made("none", "unexplained"),
    made("none", "gain"),
    made("none", "none"),
    made("unknown:telegraph", "unexplained"),
    made("unknown:telegraph", "drift"),
    made("unknown:bursts", "none"),
]


def test_rounds_are_counted() -> None:
    summary = summarise(ROUNDS)
    assert summary.rounds == 11
    assert summary.confusion == {
        "creep": {"creep": 2, "rate": 1},
        "lag": {"none": 1},
        "none": {"none": 2, "unexplained": 1, "gain": 1},
        "unknown:bursts": {"none": 1},
        "unknown:telegraph": {"unexplained": 1, "drift": 1},
    }
    assert summary.right_first == pytest.approx(2 / 4)
    assert summary.right_or_confounded == pytest.approx(3 / 4)
    assert summary.false_alarms == pytest.approx(1 / 4)
    assert summary.unknown_left == pytest.approx(2 / 3)
    assert summary.removed == pytest.approx(0.7)
    assert summary.removed_mean == pytest.approx((0.09 + 0.2) / (0.1 + 0.4))
    assert summary.parameters_within == pytest.approx(1 / 2)
    assert summary.rates["all_named"].hits == 1
    assert {truth: set(ranges) for truth, ranges in summary.power.items()} == {
        "creep": {"1 to 1.4", "1.4 to 2"},
        "lag": {"0.5 to 0.71"},
    }
    assert summary.power["creep"]["1 to 1.4"].share == 0.5


def test_power_counts_forms_together_and_each_of_two_causes() -> None:
    pair = made(
        "creep: relaxing + drift: linear",
        "gain",
        accepted=(("creep",), ("drift",)),
        named=("gain", "drift"),
    )
    power = summarise([pair, made("creep: power law", "creep", right=True)]).power
    assert (power["creep"]["1 to 1.4"].hits, power["creep"]["1 to 1.4"].rounds) == (1, 2)
    assert (power["drift"]["1 to 1.4"].hits, power["drift"]["1 to 1.4"].rounds) == (1, 1)
    assert set(power) == {"creep", "drift"}


def test_the_power_of_all_forms_is_told_by_rising_strength() -> None:
    strengths = {"creep: power law": 1.9, "creep: relaxing": 0.6, "creep: two constants": 1.1}
    rounds = [made(truth, "creep", strength=strength) for truth, strength in strengths.items()]
    assert list(summarise(rounds).power["creep"]) == ["0.5 to 0.71", "1 to 1.4", "1.4 to 2"]


def test_models_with_a_false_alarm_are_counted() -> None:
    # Of three models, the second is alarmed in one of two clean rounds; what is injected does not count.
    rounds = [
        made("none", "none"),
        made("none", "gain", base_model=1),
        made("none", "unexplained", base_model=1),
        made("none", "none", base_model=2),
        made("lag", "drift", base_model=2),
    ]
    alarmed = summarise(rounds).rates["models_alarmed"]
    assert (alarmed.hits, alarmed.rounds) == (1, 3)
    # One model is no sample of models.
    assert "models_alarmed" not in summarise(ROUNDS).rates


def test_intervals_are_exact() -> None:
    # Hanley and Lippman-Hand 1983: none of 300 bounds a rate at about 3 of 300, here two-sided.
    none = rate([False] * 300)
    assert (none.low, none.share) == (0.0, 0.0)
    assert none.high == pytest.approx(1 - 0.025 ** (1 / 300))
    half = rate([True] * 5 + [False] * 5)
    assert (half.low, half.high) == (pytest.approx(0.1871, abs=1e-4), pytest.approx(0.8129, abs=1e-4))


def test_nothing_to_count_is_none() -> None:
    summary = summarise([made("none", "none")])
    assert summary.false_alarms == 0.0
    assert summary.right_first is None
    assert summary.unknown_left is None
    assert summary.removed is None
    assert summary.removed_mean is None
    assert summary.parameters_within is None
    assert summarise([]).confusion == {}


def test_a_summary_of_an_older_version_is_read() -> None:
    older = summarise(ROUNDS).model_dump(mode="json", exclude={"rates", "power"})
    assert Summary.model_validate(older).confusion["lag"] == {"none": 1}


def test_an_earlier_round_is_read() -> None:
    finished = made("lag", "lag", injected={"lag": 0.05})
    kept = finished.model_dump(mode="json", by_alias=True)
    assert kept["planted"] == {"lag": 0.05}
    assert "injected" not in kept
    assert Round.model_validate(kept) == finished


def test_pictures_are_drawn_of_what_there_is(tmp_path: Path) -> None:
    assert write_pictures(summarise([]), tmp_path) == ()
    assert write_pictures(summarise([made("none", "none")]), tmp_path) == (tmp_path / CONFUSION,)
    written = write_pictures(summarise(ROUNDS), tmp_path)
    assert written == (tmp_path / CONFUSION, tmp_path / POWER)
    assert all(path.read_bytes().startswith(b"\x89PNG") for path in written)


def test_lines_on_a_channels_sensitivity_are_counted() -> None:
    """What another electrode's line says does not count, nor do rounds of older files."""
    dying = {"truth": "dying electrode: linear", "found": "none", "injected": {"channel": "e3"}}
    rates = summarise(
        [
            made(**dying, changed=("e1", "e3")),
            made(**dying, changed=("e1",)),
            made(**dying),
            made("none", "none", changed=()),
            made("drift", "drift", changed=("e1",)),
            made("fault: stuck", "fault", changed=("e1",)),
        ]
    ).rates
    assert (rates["change_told"].hits, rates["change_told"].rounds) == (1, 2)
    assert (rates["change_false"].hits, rates["change_false"].rounds) == (1, 2)
    assert "change_false" not in summarise(ROUNDS).rates
    assert DYING in {injector.cause for injector in INJECTORS}
