import pytest

from taxel_bench.verdict import queries_for, too_few, verdict


@pytest.mark.parametrize(("percentile", "queries"), [(90, 64), (99, 662)])
def test_as_many_queries_as_mlperf_asks_for(percentile: float, queries: int) -> None:
    assert queries_for(percentile) == queries


def test_too_few_queries_make_a_measurement_invalid() -> None:
    assert verdict(too_few(661, 99)) == {
        "verdict": "INVALID",
        "reasons": ["661 queries do not support p99: at least 662 are needed"],
    }
    assert verdict(too_few(662, 99)) == {"verdict": "VALID", "reasons": []}
