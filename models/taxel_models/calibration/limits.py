"""Forces that separate contact from no contact, and light from strong."""

from dataclasses import dataclass
from typing import Final

from taxel.errors import SettingsError

LIGHT_N: Final = 0.3
"""A contact is light below this force (the paper)."""

TOUCH_N: Final = 0.05
"""Above this force a row is in contact."""


@dataclass(frozen=True)
class Limits:
    """Forces, N, that separate contact from no contact, and light from strong.

    Raises:
        SettingsError: they are not in order.
    """

    touch: float = TOUCH_N
    light: float = LIGHT_N

    def __post_init__(self) -> None:
        if not 0 < self.touch < self.light:
            raise SettingsError(f"touch {self.touch} N, light {self.light} N: expected 0 < touch < light")
