"""What effects add to a prediction, against loops that spell their equations out."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from pydantic import ValidationError

from taxel.channels import CHANNELS
from taxel.corrections import (
    CALIBRATION_AGE,
    CALIBRATION_EXTRAS,
    AppliedEffect,
    Calibrated,
    Composition,
    Correction,
    CountLimits,
    Crosstalk,
    Fault,
    Frame,
    Leak,
    Location,
    Parameter,
    RandomFeatures,
    Saturation,
    Term,
    Weighted,
)
from taxel.manifest import Manifest
from taxel.windows import ExtraFeature, WindowSpec

BY_0_1 = Path(__file__).parent / "corrected_by_0_1"

SPEC = WindowSpec.of(7)
EXTRAS = (
    ExtraFeature(name="tdc", unit="counts", default=1900.0),
    ExtraFeature(name="creep", unit="N", taken_by="effects"),
    *CALIBRATION_EXTRAS,
    CALIBRATION_AGE,
)
NAMES = (*SPEC.features, *(extra.name for extra in EXTRAS))
IDENTITY = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
QUARTER = ((0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0))
"""A quarter turn about z: x becomes y."""

Rows = NDArray[np.float64]


def rows_of(values: Rows) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(row) for row in values.tolist())


def terms(rng: np.random.Generator) -> list[Any]:
    """One of each kind and shape that is added, with random numbers."""
    rest, level, slope = (tuple(rng.uniform(0, 100, 21).tolist()) for _ in range(3))
    shapes: tuple[Any, ...] = ("unit", "signal", "log_impedance")
    weighted = [
        Weighted(
            shape=shape,
            features=("fz", "one", "creep", "x[last]"),
            references=(0.5, 0.0, -1.0, 0.01),
            weights=rows_of(rng.normal(size=(4, 21))),
            rest=rest,
        )
        for shape in shapes
    ]
    return [
        *weighted,
        Weighted(
            shape="unit", features=("one",), references=(0.0,), weights=rows_of(rng.normal(size=(1, 21)))
        ),
        Location(
            centres=rows_of(rng.normal(size=(5, 3)) * 0.01),  # type: ignore[arg-type]
            width=0.004,
            half_force=0.7,
            weights=rows_of(rng.normal(size=(5, 21))),
        ),
        Crosstalk(leaks=(Leak("e1", "e2", 0.1), Leak("e1", "pdc", -0.2), Leak("e9", "e1", 0.3)), rest=rest),
        Saturation(slope=slope, level=level, rest=rest),
        Calibrated(
            stays=slope,
            fades=level,
            time_constant_s=0.5,
            others=rows_of(rng.normal(size=(21, 21))),
            limits=tuple(rng.uniform(0, 1, 21).tolist()),
        ),
        RandomFeatures(
            features=("fz", "creep"),
            means=tuple(rng.uniform(0, 4095, 23).tolist()),
            scales=tuple(rng.uniform(0.1, 1000, 23).tolist()),
            limit=2.0,
            projection=rows_of(rng.normal(size=(23, 5))),
            phases=tuple(rng.uniform(0, 6, 5).tolist()),
            weights=rows_of(rng.normal(size=(5, 21))),
            constants=slope,
        ),
    ]


def obvious(term: Term, p: Rows, columns: dict[str, float], channel: int) -> float:
    """The equation of a term for one window, with plain numbers."""
    name = CHANNELS[channel]
    match term:
        case Weighted():
            amount = sum(
                weights[channel] * ((1.0 if feature == "one" else columns[feature]) - reference)
                for feature, reference, weights in zip(
                    term.features, term.references, term.weights, strict=True
                )
            )
            if term.shape == "signal":
                assert term.rest is not None
                return amount * (p[channel] - term.rest[channel])
            if term.shape == "log_impedance" and name not in ("pac0", "pdc"):
                return amount * -p[channel] * (1 - p[channel] / 4095)
            return amount
        case Location():
            position = [columns[axis] for axis in "xyz"]
            force = math.hypot(columns["fx"], columns["fy"], columns["fz"])
            bumps = sum(
                weights[channel] * math.exp(-(math.dist(position, centre) ** 2) / (2 * term.width**2))
                for centre, weights in zip(term.centres, term.weights, strict=True)
            )
            return force / (force + term.half_force) * bumps
        case Crosstalk():
            sources = [(CHANNELS.index(leak.source), leak.weight) for leak in term.leaks if leak.to == name]
            return sum(weight * (p[source] - term.rest[source]) for source, weight in sources)
        case Saturation():
            s = p[channel] - term.rest[channel]
            return -term.slope[channel] * math.copysign(max(abs(s) - term.level[channel], 0), s)
        case Calibrated():
            share = term.stays[channel] + term.fades[channel] * math.exp(
                -max(columns["calibration_age"], 0.0) / term.time_constant_s
            )
            found = {name: columns[f"calibration_{name}"] for name in CHANNELS}
            others = sum(
                weights[channel] * min(max(found[other], -limit), limit)
                for other, weights, limit in zip(CHANNELS, term.others, term.limits, strict=True)
            )
            return share * found[name] + others
        case RandomFeatures():
            inputs = [*p.tolist(), *(columns[feature] for feature in term.features)]
            z = [
                min(max((value - mean) / scale, -term.limit), term.limit)
                for value, mean, scale in zip(inputs, term.means, term.scales, strict=True)
            ]
            cosines = [
                math.cos(
                    phase + sum(row[place] * part for row, part in zip(term.projection, z, strict=True))
                )
                for place, phase in enumerate(term.phases)
            ]
            return term.constants[channel] + sum(
                weights[channel] * cosine for weights, cosine in zip(term.weights, cosines, strict=True)
            )
    raise AssertionError(term)


def some_windows(rng: np.random.Generator, rows: int = 4) -> NDArray[np.float32]:
    windows = rng.normal(size=(rows, len(NAMES)))
    windows[:, :9] *= 0.01
    return windows.astype(np.float32)


@given(st.integers(0, 2**32))
@settings(max_examples=20)
def test_terms_equal_their_equations(seed: int) -> None:
    rng = np.random.default_rng(seed)
    p = rng.uniform(-200, 4500, (4, 21))
    values = some_windows(rng).astype(np.float64)
    columns = dict(zip(NAMES, values.T, strict=True))
    for term in terms(rng):
        assert set(term.takes) <= set(NAMES)
        found = term.delta(p, {name: columns[name] for name in term.takes})
        expected = [
            [obvious(term, p[row], dict(zip(NAMES, values[row], strict=True)), c) for c in range(21)]
            for row in range(4)
        ]
        np.testing.assert_allclose(found, expected, rtol=1e-10, atol=1e-8)


@given(st.integers(0, 2**32), st.booleans())
def test_a_correction_adds_its_terms_to_the_base_in_any_order(seed: int, spread: bool) -> None:
    rng = np.random.default_rng(seed)
    windows = some_windows(rng)
    outputs = rng.uniform(0, 4095, (4, 42 if spread else 21)).astype(np.float32)
    seen: list[NDArray[np.float32]] = []

    def base(inputs: NDArray[np.float32]) -> NDArray[np.float32]:
        seen.append(inputs)
        return outputs

    everything = [*terms(rng), Fault(channel="e3", value=9.0), Fault(channel="e3", value=12.0)]
    effects = [effect_of(*everything[:4]), effect_of(*everything[4:])]
    found = Correction(effects, SPEC, EXTRAS).apply(base, windows)
    p = outputs[:, :21].astype(np.float64)
    columns = dict(zip(NAMES, windows.astype(np.float64).T, strict=True))
    expected = p + sum(term.delta(p, columns) for term in everything[:-2])
    expected[:, CHANNELS.index("e3")] = 12.0
    np.testing.assert_allclose(found[:, :21], expected, rtol=1e-6, atol=1e-3)
    np.testing.assert_array_equal(found[:, 21:], outputs[:, 21:])
    np.testing.assert_array_equal(seen[0], windows[:, : SPEC.length + 1])
    assert seen[0].flags.c_contiguous


def effect_of(*some: Term, **fields: Any) -> AppliedEffect:
    return AppliedEffect(name="something", about="Something.", channels=CHANNELS, terms=some, **fields)


def test_order_does_not_matter() -> None:
    rng = np.random.default_rng(5)
    windows, everything = some_windows(rng), terms(rng)
    base = rng.uniform(0, 4095, (4, 21)).astype(np.float32)
    first, second = (
        Correction([effect_of(*some)], SPEC, EXTRAS).apply(lambda _: base, windows)
        for some in (everything, everything[::-1])
    )
    np.testing.assert_allclose(first, second, rtol=1e-6)


def test_terms_know_shifted_windows_by_the_names_of_the_model() -> None:
    shifted = WindowSpec.of(7, shift=4)
    windows = some_windows(np.random.default_rng(1))
    base = np.full((4, 21), 1000.0, np.float32)
    term = Weighted(shape="unit", features=("fz",), references=(0.0,), weights=((1.0,) * 21,))
    found = Correction([effect_of(term, shift_ticks=4)], shifted, EXTRAS).apply(lambda _: base, windows)
    np.testing.assert_allclose(found[:, 5] - 1000, windows[:, SPEC.features.index("fz")], atol=1e-3)


def test_terms_may_be_added_to_other_counts_than_the_base() -> None:
    rng = np.random.default_rng(7)
    p, start = rng.uniform(0, 4095, (2, 4, 21))
    columns = dict(zip(NAMES, some_windows(rng).astype(np.float64).T, strict=True))
    some = terms(rng)
    composition = Composition([Fault(channel="e3", value=12.0), *some])
    found = composition.counts(p, columns, start=start)
    expected = start + sum(term.delta(p, columns) for term in some)
    expected[:, CHANNELS.index("e3")] = 12.0
    np.testing.assert_allclose(found, expected, rtol=1e-12)
    zero = composition.counts(p, columns, start=np.zeros_like(p))
    np.testing.assert_allclose(composition.counts(p, columns)[:, :4] - zero[:, :4], p[:, :4], rtol=1e-9)


@given(st.integers(0, 2**32))
def test_limits_keep_what_the_terms_add_up_to_and_faults_come_last(seed: int) -> None:
    rng = np.random.default_rng(seed)
    p = rng.uniform(0, 4095, (4, 21))
    columns = dict(zip(NAMES, some_windows(rng).astype(np.float64).T, strict=True))
    limits = CountLimits(channels=("e3", "e5", "pdc"), low=100.0, high=3000.0)
    some = [*terms(rng), Fault(channel="e3", value=12.0)]
    free, kept = (Composition(each).counts(p, columns) for each in (some, [limits, *some]))
    expected = free.copy()
    within = [CHANNELS.index(channel) for channel in ("e5", "pdc")]
    expected[:, within] = np.clip(free[:, within], 100.0, 3000.0)
    np.testing.assert_array_equal(kept, expected)


def test_limits_in_the_wrong_order_are_refused() -> None:
    with pytest.raises(ValidationError, match="low 5, high 5: expected low below high"):
        CountLimits(channels=("e3",), low=5.0, high=5.0)


def test_a_manifest_of_0_1_gives_the_same_counts() -> None:
    """It calls terms places, mix, limit and substitute; today they are called as their effects.

    `Correction.apply` of 0.1.0 wrote the counts (commit b59186e), on random windows and a random base.
    """
    text = (BY_0_1 / "manifest.json").read_text("utf-8")
    manifest = Manifest.model_validate_json(text)
    kinds = [term.kind for effect in manifest.effects for term in effect.terms]
    assert kinds == ["weighted", "location", "crosstalk", "saturation", "fault"]
    former = [term["kind"] for effect in json.loads(text)["effects"] for term in effect["terms"]]
    assert former == ["weighted", "places", "mix", "limit", "substitute"]
    known = {
        name: np.array(rows) for name, rows in json.loads((BY_0_1 / "counts.json").read_text()).items()
    }
    correction = Correction(manifest.effects, manifest.spec, manifest.window.extras)
    base, windows = known["base"].astype(np.float32), known["windows"].astype(np.float32)
    np.testing.assert_allclose(correction.apply(lambda _: base, windows), known["corrected"], rtol=2e-7)
    written = json.loads(manifest.model_dump_json())
    assert [term["kind"] for effect in written["effects"] for term in effect["terms"]] == kinds
    assert Manifest.model_validate_json(manifest.model_dump_json()) == manifest


class TestFrame:
    def test_identity_changes_nothing(self) -> None:
        windows = some_windows(np.random.default_rng(2))
        frame = Frame(position_rotation=IDENTITY, position_translation=(0, 0, 0), force_rotation=IDENTITY)
        np.testing.assert_array_equal(frame.turn(windows, SPEC), windows)

    def test_every_position_and_force_is_turned(self) -> None:
        windows = some_windows(np.random.default_rng(3))
        frame = Frame(position_rotation=QUARTER, position_translation=(0.5, 0, 0), force_rotation=IDENTITY)
        turned = frame.turn(windows, SPEC)
        for first in (0, 3, 6):
            x, y, z = windows[:, first : first + 3].T
            np.testing.assert_allclose(turned[:, first : first + 3].T, [0.5 - y, x, z], atol=1e-7)
        np.testing.assert_array_equal(turned[:, 9:], windows[:, 9:])

    def test_no_windows_are_turned_to_none(self) -> None:
        frame = Frame(position_rotation=QUARTER, position_translation=(0.5, 0, 0), force_rotation=IDENTITY)
        none = np.zeros((0, some_windows(np.random.default_rng(3)).shape[1]), np.float32)
        assert frame.turn(none, SPEC).shape == none.shape

    def test_forces_turn_apart(self) -> None:
        windows = some_windows(np.random.default_rng(4))
        frame = Frame(position_rotation=IDENTITY, position_translation=(0, 0, 0), force_rotation=QUARTER)
        turned = frame.turn(windows, SPEC)
        np.testing.assert_array_equal(turned[:, :9], windows[:, :9])
        np.testing.assert_array_equal(turned[:, 9::3][:, :3], -windows[:, 10::3][:, :3])
        np.testing.assert_array_equal(turned[:, -2:], windows[:, -2:])

    def test_forces_have_another_zero_and_scale(self) -> None:
        windows = some_windows(np.random.default_rng(5))
        still = {"position_rotation": IDENTITY, "position_translation": (0, 0, 0)}
        frame = Frame(**still, force_rotation=QUARTER, force_translation=(0.5, 0, -2), force_scale=1.2)
        turned = frame.turn(windows, SPEC)
        np.testing.assert_array_equal(turned[:, :9], windows[:, :9])
        x, y, z = (windows[:, 9 + axis :: 3][:, :3] for axis in range(3))
        for axis, expected in enumerate((0.5 - 1.2 * y, 1.2 * x, 1.2 * z - 2)):
            np.testing.assert_allclose(turned[:, 9 + axis :: 3][:, :3], expected, rtol=1e-6)
        # Manifests of earlier versions have neither.
        before = Frame(**still, force_rotation=QUARTER)
        written = before.model_dump()
        assert Frame.model_validate({name: written[name] for name in (*still, "force_rotation")}) == before
        with pytest.raises(ValidationError, match="greater than 0"):
            Frame(**still, force_rotation=QUARTER, force_scale=0.0)

    def test_the_newest_turns_first_and_terms_see_what_was_given(self) -> None:
        windows = some_windows(np.random.default_rng(6))
        moved = Frame(position_rotation=IDENTITY, position_translation=(1, 0, 0), force_rotation=IDENTITY)
        turned = Frame(position_rotation=QUARTER, position_translation=(0, 0, 0), force_rotation=QUARTER)
        term = Weighted(shape="unit", features=("x",), references=(0.0,), weights=((1.0,) * 21,))

        def base(inputs: NDArray[np.float32]) -> NDArray[np.float32]:
            np.testing.assert_allclose(inputs[:, 0], 1 - windows[:, 1], rtol=1e-6)
            np.testing.assert_allclose(inputs[:, 1], windows[:, 0], atol=1e-7)
            return np.zeros((len(inputs), 21), np.float32)

        effects = [effect_of(frame=moved), effect_of(term, frame=turned)]
        found = Correction(effects, SPEC, EXTRAS).apply(base, windows)
        np.testing.assert_allclose(found[:, 0], windows[:, 0], rtol=1e-6)

    def test_an_axis_may_have_the_wrong_sign(self) -> None:
        mirror = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, -1.0))
        frame = Frame(position_rotation=mirror, position_translation=(0, 0, 0), force_rotation=IDENTITY)
        windows = np.arange(SPEC.length, dtype=np.float32)[None]
        moved = frame.turn(windows, SPEC)
        positions = 3 * len(SPEC.positions)
        signs = np.tile([1.0, 1.0, -1.0], len(SPEC.positions))
        np.testing.assert_array_equal(moved[0, :positions], signs * windows[0, :positions])
        np.testing.assert_array_equal(moved[0, positions:], windows[0, positions:])

    def test_what_is_no_rotation_is_refused(self) -> None:
        stretch = ((1.1, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
        # Its product with its transpose is no number.
        endless = ((1e200, -1e200, 0.0), (1e200, 1e200, 0.0), (0.0, 0.0, 1.0))
        for matrix in (stretch, endless):
            with pytest.raises(ValidationError, match="expected a rotation"):
                Frame(position_rotation=matrix, position_translation=(0, 0, 0), force_rotation=IDENTITY)


def test_effects_survive_being_written() -> None:
    frame = Frame(position_rotation=QUARTER, position_translation=(0, 0, 0.1), force_rotation=QUARTER)
    effect = effect_of(
        *terms(np.random.default_rng(0)),
        Fault(channel="e1", value=0.0),
        frame=frame,
        shift_ticks=-2,
        parameters=(Parameter(name="lag", value=-2.0, unit="ticks", low=-2.5, high=-1.5),),
    )
    assert AppliedEffect.model_validate_json(effect.model_dump_json()) == effect
