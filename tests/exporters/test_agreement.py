"""How far predictions lie apart is told by the worst of them, and named where it is too far."""

import numpy as np
import pytest

from taxel.errors import ArtifactError
from taxel_exporters.agreement import agreement


def test_the_largest_difference_is_kept() -> None:
    expected = np.random.default_rng(0).uniform(0, 4095, (5, 21)).astype(np.float32)
    found = expected.copy()
    found[3, 7] += 0.5
    found[1, 2] -= 0.25
    parity = agreement(found, expected, 0.75, "the other")
    assert (parity.windows, parity.tolerance) == (5, 0.75)
    assert parity.largest_difference == pytest.approx(0.5, abs=1e-3)


@pytest.mark.parametrize("value", [101.0, np.nan, np.inf])
def test_what_differs_too_much_is_named(value: float) -> None:
    expected = np.full((5, 21), 100.0)
    found = expected.astype(np.float32)
    found[0, 0], found[3, 6] = 100.9, value
    message = rf"window 3, channel e5: the artifact gives {value}, the other 100.0: expected at most 0.95 "
    with pytest.raises(ArtifactError, match=message):
        agreement(found, expected, 0.95, "the other")
