"""Windows whose middle lies some ticks before T."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from taxel.errors import InvalidArgument
from taxel.manifest import WindowLayout
from taxel.windows import COMBINATIONS, ExtraFeature, Samples, WindowSpec, build_windows


@given(st.integers(0, 2**32), st.sampled_from(COMBINATIONS), st.integers(-25, 25))
def test_a_shifted_window_is_the_unshifted_one_of_another_moment(
    seed: int, combination: int, shift: int
) -> None:
    rng = np.random.default_rng(seed)
    time = np.arange(120) * 10_000_000
    time[70:] += 300_000_000
    position = np.cumsum(rng.normal(size=(120, 3)) * 1e-6, axis=0)
    samples = Samples.of(time, position, rng.normal(size=(120, 3)), rate_hz=100)
    spec = WindowSpec.of(combination, shift)
    plain = build_windows(samples, spec.unshifted)
    shifted = build_windows(samples, spec)
    at = dict(zip(plain.rows.tolist(), plain.values, strict=True))
    segment_of = np.repeat([0, 1], [70, 50])
    expected = [t for t in range(120) if t - shift in at and segment_of[t] == segment_of[t - shift]]
    assert shifted.rows.tolist() == expected
    for t, values in zip(shifted.rows.tolist(), shifted.values, strict=True):
        np.testing.assert_array_equal(values, at[t - shift])


def test_a_shifted_spec_says_so() -> None:
    spec = WindowSpec.of(1, shift=3)
    assert spec.features[:4] == ("x[-3]", "y[-3]", "z[-3]", "fx[-3]")
    assert spec.features[6::3] == ("fx[-13]", "fx[+7]")
    assert (spec.look_back, spec.look_ahead, spec.delay_s) == (13, 7, 0.07)
    assert spec.unshifted == WindowSpec.of(1)
    assert WindowSpec.of(7, shift=-2).features[:9:3] == ("x[+2]", "x[last+2]", "x[next+2]")
    assert WindowSpec.of(3, shift=3).look_ahead == 0
    assert WindowSpec.of(6, shift=-12).look_back == 0


def test_an_endless_shift_is_refused() -> None:
    with pytest.raises(InvalidArgument, match="shift 101: expected at most 100 ticks"):
        WindowSpec.of(1, shift=101)


@pytest.mark.parametrize(
    ("shift", "names"), [(0, ["fz"]), (3, ["fz"]), (3, ["fz[-3]"]), (0, ["tdc", "tdc"])]
)
def test_extras_need_names_of_their_own(shift: int, names: list[str]) -> None:
    """Also other names than an unshifted window's features have, as effects know them by."""
    extras = tuple(ExtraFeature(name=name, unit="", taken_by="effects") for name in names)
    with pytest.raises(ValidationError, match="expected names that no other feature has"):
        WindowLayout.of(WindowSpec.of(1, shift), extras)
