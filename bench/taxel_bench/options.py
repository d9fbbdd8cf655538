"""Options that several commands share."""

from collections.abc import Callable, Container, Iterable
from typing import Annotated, TypeVar

import typer

from taxel.errors import SettingsError
from taxel.protocol import MAX_ROWS

T = TypeVar("T")

Repetitions = Annotated[
    int | None, typer.Option(min=2, help="Timed calls at each size; as many as p99 needs if not given.")
]
Seconds = Annotated[
    float,
    typer.Option(min=0.1, help="Longest time for the calls at each size, unless --repetitions is given."),
]
Gaps = Annotated[
    str, typer.Option(help="Pauses between an answer and the next query, with commas between.")
]
Seed = Annotated[int, typer.Option(help="Of random windows, and of models of the paper's size.")]


def parse_batches(text: str) -> list[int]:
    """Batch sizes from `1,8,64`.

    Raises:
        SettingsError: one is not a whole number from 1 to as many windows as a call may have.
    """
    return parse_numbers("--batch", text, range(1, MAX_ROWS + 1), f"1 to {MAX_ROWS}")


def parse_names(option: str, text: str, known: Iterable[str], what: str) -> list[str]:
    """Names from `fastapi,grpc`, each once, in the order given.

    Args:
        what: they name.

    Raises:
        SettingsError: one is not known.
    """
    names = list(dict.fromkeys(part.strip() for part in text.split(",")))
    every = list(dict.fromkeys(known))
    if unknown := [name for name in names if name not in every]:
        raise SettingsError(f"{option} {text}: no {what} {unknown[0]!r}; there is: {', '.join(every)}")
    return names


def parse_numbers(option: str, text: str, allowed: Container[int], expected: str) -> list[int]:
    """Whole numbers from `1,8,64`, in the order given.

    Raises:
        SettingsError: one is none, or is not allowed.
    """
    numbers = _numbers(text, int)
    if not numbers or not all(number in allowed for number in numbers):
        raise SettingsError(f"{option} {text}: expected whole numbers, {expected}, with commas between")
    return numbers


def parse_gaps(text: str) -> list[float]:
    """Pauses between queries from `0,1,10`, in milliseconds.

    Raises:
        SettingsError: one is not a number from 0 to 1000.
    """
    gaps = _numbers(text, float)
    if not gaps or not all(0 <= gap <= 1000 for gap in gaps):
        raise SettingsError(f"--gap-ms {text}: expected milliseconds from 0 to 1000, with commas between")
    return gaps


def _numbers(text: str, number: Callable[[str], T]) -> list[T]:
    """The numbers between commas; none if one of them is no number."""
    try:
        return [number(part) for part in text.split(",")]
    except ValueError:
        return []
