"""A bar: what a figure must reach."""

from typing import Any, NamedTuple


class Bar(NamedTuple):
    """A figure and its limit.

    Attributes:
        what: the figure's name and unit.
        figure: as measured.
        limit: that it must not exceed; None if it is told only.
        at_least: whether it must not be less, instead.
    """

    what: str
    figure: float
    limit: float | None
    at_least: bool = False

    @property
    def holds(self) -> bool:
        """Whether the figure is within its limit."""
        if self.limit is None:
            return True
        return self.figure >= self.limit if self.at_least else self.figure <= self.limit

    @property
    def wanted(self) -> str:
        """The limit, for a table."""
        if self.limit is None:
            return ""
        return f"{'at least' if self.at_least else 'at most'} {self.limit:g}"

    @property
    def verdict(self) -> str:
        """`VALID` or `INVALID`, where there is a limit."""
        if self.limit is None:
            return "not judged"
        return "VALID" if self.holds else "INVALID"

    def as_dict(self) -> dict[str, Any]:
        """For `--json`."""
        return {**self._asdict(), "verdict": self.verdict}
