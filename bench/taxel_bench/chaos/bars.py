"""A bar: what a figure must reach."""

from typing import Any, NamedTuple


class Bar(NamedTuple):
    """A figure and its limit.

    Attributes:
        what: the figure's name and unit.
        figure: as measured.
        limit: that it must not exceed.
        at_least: whether it must not be less, instead.
        excused: why it is not judged; empty if it is.
    """

    what: str
    figure: float
    limit: float
    at_least: bool = False
    excused: str = ""

    @property
    def holds(self) -> bool:
        """Whether the figure is within its limit, or is not judged."""
        if self.excused:
            return True
        return self.figure >= self.limit if self.at_least else self.figure <= self.limit

    @property
    def wanted(self) -> str:
        """The limit, for a table."""
        return f"{'at least' if self.at_least else 'at most'} {self.limit:g}"

    @property
    def verdict(self) -> str:
        """`VALID` or `INVALID`, or why there is none."""
        return self.excused or ("VALID" if self.holds else "INVALID")

    def as_dict(self) -> dict[str, Any]:
        """For `--json`."""
        return {**self._asdict(), "verdict": self.verdict}
