"""Which of several servers is asked next."""

from collections import Counter
from itertools import product
from random import Random

from hypothesis import given
from hypothesis import strategies as st

from taxel.remote.replicas import Load, draw_two, sooner

LOADS = st.builds(Load, st.integers(0, 1000), st.floats(1e-4, 100))


@given(st.integers(2, 50), st.randoms())
def test_two_different_servers_are_drawn(count: int, random: Random) -> None:
    first, second = draw_two(count, random.randrange)
    assert 0 <= first < count
    assert 0 <= second < count
    assert first != second


def test_a_lone_server_is_drawn_twice() -> None:
    assert draw_two(1, Random(0).randrange) == (0, 0)


def test_every_pair_is_as_likely_as_any() -> None:
    """All outcomes of the two draws, each once."""
    for count in (2, 3, 4, 7):
        drawn = Counter()
        for first, second in product(range(count), range(count - 1)):
            outcomes = iter((first, second))
            drawn[draw_two(count, lambda _, told=outcomes: next(told))] += 1
        assert len(drawn) == count * (count - 1)
        assert set(drawn.values()) == {1}


@given(st.lists(LOADS, min_size=2, max_size=8), st.data())
def test_the_one_expected_sooner_is_asked(loads: list[Load], data: st.DataObject) -> None:
    first, second = (data.draw(st.integers(0, len(loads) - 1)) for _ in range(2))
    chosen = sooner(loads, first, second)
    assert chosen in (first, second)
    assert loads[chosen].expected_s == min(loads[first].expected_s, loads[second].expected_s)
    assert sooner(loads, second, first) in (first, second)


@given(LOADS, st.integers(1, 100))
def test_what_is_outstanding_counts_and_so_does_latency(load: Load, more: int) -> None:
    busier = load._replace(outstanding=load.outstanding + more)
    slower = load._replace(latency_s=load.latency_s * (1 + more))
    for worse in (busier, slower):
        assert sooner([worse, load], 0, 1) == 1
        assert sooner([load, worse], 0, 1) == 0


def test_a_slow_server_gets_the_smaller_share() -> None:
    """Requests that arrive one after the other, at three servers of which one takes four times as long."""
    random, busy_until, asked = Random(1), [0.0, 0.0, 0.0], Counter()
    latency = (0.004, 0.001, 0.001)
    for step in range(6000):
        now = step * 0.0005
        waiting = [
            round(max(until - now, 0) / each) for until, each in zip(busy_until, latency, strict=True)
        ]
        loads = [Load(*each) for each in zip(waiting, latency, strict=True)]
        chosen = sooner(loads, *draw_two(3, random.randrange))
        busy_until[chosen] = max(busy_until[chosen], now) + latency[chosen]
        asked[chosen] += 1
    assert asked[0] < asked[1] / 2
    assert abs(asked[1] - asked[2]) < 0.1 * asked[1]
