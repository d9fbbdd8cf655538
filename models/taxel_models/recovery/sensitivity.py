"""Sensitivity: the same rounds with each constant of the inference at half and at twice its value."""

from collections.abc import Callable, Iterator, Sequence
from typing import Final

from taxel.schema import Schema
from taxel_models.loop.inference.constants import DECLARED
from taxel_models.recovery.benchmark import RecoveryBenchmark
from taxel_models.recovery.rounds import Round, Summary, summarise

FACTORS: Final = (0.5, 2.0)


class Sensitivity(Schema):
    """What another value of one constant changes.

    Attributes:
        constant: its name.
        value: that was tried.
        changed: rounds that found something else first.
        rounds: all of them.
        summary: with that value.
    """

    constant: str
    value: float
    changed: int
    rounds: int
    summary: Summary


def sensitivities(
    benchmark: RecoveryBenchmark,
    rounds: Sequence[Round],
    play: Callable[[RecoveryBenchmark], Iterator[Round]],
    constants: Sequence[str] | None = None,
) -> Iterator[Sensitivity]:
    """Move one constant after another.

    Args:
        benchmark: whose rounds were played.
        rounds: with the declared constants.
        play: gives the rounds of a benchmark.
        constants: names; all if there are none.
    """
    for name in constants or DECLARED.names():
        for factor in FACTORS:
            moved = benchmark.constants.moved(name, factor)
            others = list(play(benchmark.with_constants(moved)))
            changed = sum(one.found != other.found for one, other in zip(rounds, others, strict=True))
            yield Sensitivity(
                constant=name,
                value=float(getattr(moved, name)),
                changed=changed,
                rounds=len(others),
                summary=summarise(others),
            )
