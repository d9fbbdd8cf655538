from collections.abc import Callable

import numpy as np
import pytest

from taxel.skin import patch
from taxel_models.calibration.light_contacts import LightContacts

RADIUS = 7.0


@pytest.fixture(scope="session")
def make_contacts() -> Callable[..., LightContacts]:
    """Contacts of one weightless touch each, off the skin by a standoff, and by noise, in its frame."""

    def make(
        count: int = 60,
        *,
        along: tuple[float, float] = (-14.0, 10.0),
        around: float = 2.0,
        standoff: float = 0.0,
        noise: float = 0.0,
        seed: int = 0,
    ) -> LightContacts:
        dice = np.random.default_rng(seed)
        places = patch(dice.uniform(*along, count), dice.uniform(-around, around, count), RADIUS)
        points = places.point + standoff * places.normal + noise * dice.standard_normal((count, 3))
        return LightContacts(points, np.zeros(count), np.arange(count), points)

    return make
