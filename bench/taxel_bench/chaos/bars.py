"""A bar: what a figure must reach."""

from typing import Any, NamedTuple


class Bar(NamedTuple):
    """A figure and its limit.

    Attributes:
        what: the figure's name and unit.
        figure: as measured.
        limit: that it must not exceed.
        at_least: whether it must not be less, instead.
    """

    what: str
    figure: float
    limit: float
    at_least: bool = False

    @property
    def holds(self) -> bool:
        """Whether the figure is within its limit."""
        return self.figure >= self.limit if self.at_least else self.figure <= self.limit

    @property
    def wanted(self) -> str:
        """The limit, for a table."""
        return f"{'at least' if self.at_least else 'at most'} {self.limit:g}"

    def as_dict(self) -> dict[str, Any]:
        """For `--json`."""
        return {**self._asdict(), "verdict": "VALID" if self.holds else "INVALID"}
