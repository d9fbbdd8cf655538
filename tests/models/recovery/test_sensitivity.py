"""Each constant of the inference is moved, and the same rounds are played again."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial

import pytest

from taxel_models.ground.twins import StoredModel, TwinGround
from taxel_models.loop.inference.constants import DECLARED, Constants
from taxel_models.recovery.benchmark import RecoveryBenchmark
from taxel_models.recovery.injected import Draw
from taxel_models.recovery.rounds import Round
from taxel_models.recovery.sensitivity import sensitivities
from taxel_models.recovery.workers import run_rounds_on, run_rounds_with
from taxel_models.shipped import shipped_repository


@pytest.mark.parametrize("name", DECLARED.names())
def test_a_constant_is_moved_alone(name: str) -> None:
    for factor in (0.5, 2.0):
        moved = DECLARED.moved(name, factor)
        assert getattr(moved, name) == factor * getattr(DECLARED, name)
        assert replace(moved, **{name: getattr(DECLARED, name)}) == DECLARED
        assert max(moved.included) <= 1


@pytest.fixture(scope="module")
def benchmark() -> RecoveryBenchmark:
    ground = TwinGround(StoredModel(shipped_repository(), "network-b"), 3, 5_000)
    draw = Draw("foreign", ("offset",), (1.5, 2.0), clean_share=0.0, unknown_share=0.0)
    return RecoveryBenchmark(ground, "twin", 3, draw)


@pytest.fixture(scope="module")
def rounds(benchmark: RecoveryBenchmark) -> list[Round]:
    """A round of an offset."""
    played = list(run_rounds_on(benchmark, 1))
    assert played[0].found == "offset"
    return played


@pytest.mark.long
def test_what_a_constant_decides_is_shown(benchmark: RecoveryBenchmark, rounds: list[Round]) -> None:
    """With a share that is asked for and that nothing could remove."""
    strict = DECLARED.moved("chance", 1e-200)

    def play(moved: Sequence[Constants]) -> Iterator[list[Round]]:
        assert {one.chance for one in moved} == {0.5 * strict.chance, 2 * strict.chance}
        return run_rounds_with(benchmark, moved, 1)

    below, above = sensitivities(strict, rounds, play, ("chance",))
    assert [one.changed for one in (below, above)] == [1, 1]
    assert below.summary.right_first == 0.0


@pytest.mark.long
def test_a_round_ends_where_simpler_could_mean_as_large(
    benchmark: RecoveryBenchmark, rounds: list[Round]
) -> None:
    """At twice its value, `simpler` is 1: an effect is no simpler than itself."""
    play = partial(run_rounds_with, benchmark, rounds=1)
    moved = sensitivities(DECLARED, rounds, play, ("simpler",))
    assert [(one.constant, one.value, one.changed) for one in moved] == [
        ("simpler", 0.25, 0),
        ("simpler", 1.0, 0),
    ]
