"""Grounds of the recovery benchmark: clean recordings and a model that was not trained on them."""

from typing import Literal

GroundName = Literal["twin", "slide", "lasa"]
"""Twins, or one of the real recordings."""
