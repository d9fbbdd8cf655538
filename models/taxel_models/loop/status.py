"""What the loop says of its progress, and to whom."""

from collections.abc import Callable

StatusCallback = Callable[[str], None]
"""Is told what the loop looks at."""


def silent(_: str) -> None:
    """Tells nobody."""
