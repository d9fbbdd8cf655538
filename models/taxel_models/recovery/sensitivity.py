"""Sensitivity: the same rounds with each constant of the inference at half and at twice its value."""

from collections.abc import Callable, Iterator, Sequence
from typing import Final

from taxel.schema import Schema
from taxel_models.loop.inference.constants import DECLARED, Constants
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
    declared: Constants,
    rounds: Sequence[Round],
    play: Callable[[Sequence[Constants]], Iterator[list[Round]]],
    names: Sequence[str] | None = None,
) -> Iterator[Sensitivity]:
    """Move one constant after another.

    Args:
        declared: the constants that are moved.
        rounds: with these.
        play: gives the same rounds with each of other constants.
        names: of the constants to move; all if there are none.
    """
    moves = [
        (name, declared.moved(name, factor)) for name in names or DECLARED.names() for factor in FACTORS
    ]
    for (name, moved), others in zip(moves, play([moved for _, moved in moves]), strict=True):
        changed = sum(one.found != other.found for one, other in zip(rounds, others, strict=True))
        yield Sensitivity(
            constant=name,
            value=float(getattr(moved, name)),
            changed=changed,
            rounds=len(others),
            summary=summarise(others),
        )
