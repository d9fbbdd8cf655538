"""`bench chaos`: what is judged, and how."""

from collections import Counter

from taxel.errors import ResourceExhausted
from taxel_bench.chaos.flood import bars_of
from taxel_bench.chaos.senders import Sent


def test_each_figure_of_a_flood_is_judged_by_its_bar() -> None:
    flood = {
        "rows": 64,
        "capacity_per_s": 100.0,
        "answered_per_s": 80.0,
        "refusal_ms": {"p50": 1.0, "p99": 5.1, "max": 9.0},
        "polite": {"errors": {"RESOURCE_EXHAUSTED": 1}},
        "calm_mib": 100.0,
        "after_mib": 109.0,
    }
    assert [bar.holds for bar in bars_of(flood)] == [True, False, False, True]
    kind = {"answered_per_s": 79.0, "refusal_ms": None, "polite": {"errors": {}}, "after_mib": 111.0}
    assert [bar.holds for bar in bars_of(flood | kind)] == [False, True, True, False]


def test_only_refusals_count_as_refusals_and_only_answers_in_time_as_answers() -> None:
    sent = Sent()
    sent.add(0.0, float("inf"), b"counts")
    sent.add(0.0, 0.0, b"counts, too late")
    sent.add(0.0, float("inf"), ResourceExhausted("the queue is full"))
    assert (sent.answered, len(sent.latency_ms), len(sent.refusal_ms)) == (1, 2, 1)
    assert sent.errors == Counter({"RESOURCE_EXHAUSTED": 1})
