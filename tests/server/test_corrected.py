"""A corrected model is served like any other, and gives base prediction plus effects."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import taxel
from taxel import artifacts
from taxel.channels import CHANNELS
from taxel.corrections import AppliedEffect, Fault, Frame, Weighted
from taxel.errors import InvalidArgument, Unavailable
from taxel.windows import ExtraFeature, Relaxation, Samples, WindowSpec, build_windows, history_columns
from taxel_exporters.corrected import export_corrected
from taxel_exporters.export import export
from taxel_server.engine import Engine

CREEP = ExtraFeature(
    name="creep", unit="N", history=Relaxation(of="fz", time_constant_s=0.3), taken_by="effects"
)
MATERIAL = ExtraFeature(name="material", unit="0 or 1", default=0.0, taken_by="effects")
QUARTER = ((0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0))
EFFECTS = (
    AppliedEffect(
        name="frame",
        about="Contacts are turned about z.",
        channels=CHANNELS,
        frame=Frame(
            position_rotation=QUARTER, position_translation=(0.0, 0.0, 0.2), force_rotation=QUARTER
        ),
    ),
    AppliedEffect(name="lag", about="Channels trail the contact.", channels=CHANNELS, shift_ticks=2),
    AppliedEffect(
        name="creep",
        about="Channels relax after the load changes.",
        channels=CHANNELS,
        terms=(
            Weighted(
                shape="log_impedance",
                features=("creep", "material"),
                references=(0.0, 0.5),
                weights=((0.02,) * 21, (0.1,) * 21),
            ),
        ),
    ),
    AppliedEffect(
        name="fault",
        about="An electrode is dead.",
        channels=("e5",),
        terms=(Fault(channel="e5", value=17.0),),
    ),
)


@pytest.fixture
def corrected(trained_folder: Path, tmp_path: Path) -> Path:
    """A repository of `skin` in version 1, and corrected in version 2."""
    export(trained_folder, tmp_path, name="skin")
    windows = np.random.default_rng(0).normal(size=(50, 14)).astype(np.float32)
    manifest = export_corrected(tmp_path, "skin", "1", EFFECTS, (CREEP, MATERIAL), windows=windows)
    assert manifest.version == "2"
    return tmp_path


def contacts(fingers: int, rows: int = 80) -> list[Samples]:
    rng = np.random.default_rng(1)
    time = np.arange(rows) * 10_000_000
    time[rows // 2 :] += 100_000_000
    return [
        Samples.of(time, rng.normal(size=(rows, 3)) * 0.01, np.cumsum(rng.normal(size=(rows, 3)), axis=0))
        for _ in range(fingers)
    ]


@pytest.mark.filterwarnings("ignore::taxel.errors.InputWarning")
def test_a_served_corrected_model_gives_base_and_effects(
    corrected: Path, start: Callable[..., str]
) -> None:
    samples = contacts(fingers=2)
    engine = Engine(corrected)
    engine.load_all()
    with taxel.connect(start(engine)) as server:
        predictor, base = server.predictor("skin"), server.predictor("skin", "1")
        assert predictor.manifest.effects == EFFECTS
        stream = predictor.stream(fingers=2)
        moments, found = [], []
        for row, time_ns in enumerate(samples[0].time_ns.tolist()):
            position = [contact.position[row] for contact in samples]
            force = [contact.force[row] for contact in samples]
            extras = {"material": [0.0, 1.0]} if row == 0 else None
            for window in stream.push_ns(time_ns, position, force, extras):
                moments.append(window.time_ns)
                found.append(predictor.predict(window.values))
        for finger, contact in enumerate(samples):
            plain = build_windows(contact, WindowSpec.of(1))
            kept = np.isin(plain.rows + 2, np.searchsorted(contact.time_ns, moments))
            rows = plain.rows[kept] + 2
            turned = plain.values[kept][:, [1, 0, 2, 4, 3, 5, 7, 6, 8, 10, 9, 11]] * ([-1, 1, 1] * 4)
            p = base.predict(turned + ([0.0, 0.0, 0.2] + [0.0] * 9)).astype(np.float64)
            shape = -p * (1 - p / 4095)
            shape[:, :2] = 1
            creep = history_columns(contact, [Relaxation(of="fz", time_constant_s=0.3)])[rows]
            expected = p + shape * (0.02 * creep + 0.1 * (finger - 0.5))
            expected[:, CHANNELS.index("e5")] = 17
            assert contact.time_ns[rows].tolist() == moments
            np.testing.assert_allclose([each[finger] for each in found], expected, atol=0.01)


def test_a_local_predictor_gives_its_base_bit_for_bit(corrected: Path) -> None:
    rng = np.random.default_rng(3)
    windows = rng.normal(size=(40, 14)).astype(np.float32)
    frame = EFFECTS[0].frame
    assert frame is not None
    with taxel.load(corrected) as source:
        plain, twice = source.predictor("skin", "1"), source.predictor("skin", "2")
        turned = frame.turn(windows[:, :12], plain.window)
        np.testing.assert_array_equal(twice.predict_base(windows), plain.predict(turned))
        settled = np.hstack([windows[:, :12], np.zeros((40, 2), np.float32)])
        np.testing.assert_array_equal(twice.predict_base(windows[:, :12]), twice.predict_base(settled))
        np.testing.assert_array_equal(plain.predict_base(windows[:, :12]), plain.predict(windows[:, :12]))
    with pytest.raises(Unavailable, match="closed"):
        twice.predict_base(windows)


def test_the_base_of_a_manifest_is_that_of_the_model_file(corrected: Path) -> None:
    plain, twice = (artifacts.read(corrected / "skin" / version) for version in ("1", "2"))
    same = {"version": "2", "parity": twice.manifest.parity}
    assert twice.base.manifest == plain.manifest.model_copy(update=same)
    assert twice.base.model_path == twice.model_path


def test_a_server_gives_no_base_of_a_corrected_model(corrected: Path, start: Callable[..., str]) -> None:
    windows = np.zeros((3, 12), np.float32)
    engine = Engine(corrected)
    with taxel.connect(start(engine)) as server:
        plain = server.predictor("skin", "1")
        np.testing.assert_array_equal(plain.predict_base(windows), plain.predict(windows))
        with pytest.raises(InvalidArgument, match=r"skin/2 is corrected.*expected a model of taxel\.load"):
            server.predictor("skin", "2").predict_base(windows)


def test_without_extras_a_corrected_model_is_settled(corrected: Path) -> None:
    windows = np.random.default_rng(2).normal(size=(5, 12)).astype(np.float32)
    with taxel.load(corrected) as source:
        predictor = source.predictor("skin")
        settled = np.hstack([windows, np.zeros((5, 2), np.float32)])
        np.testing.assert_array_equal(predictor.predict(windows), predictor.predict(settled))
        one_given = np.hstack([windows, np.ones((5, 1), np.float32)])
        assert not np.allclose(predictor.predict(one_given), predictor.predict(windows))


@pytest.mark.parametrize("columns", [11, 15])
def test_windows_of_another_width_are_told_both_ends(corrected: Path, columns: int) -> None:
    with taxel.load(corrected) as source:
        predictor = source.predictor("skin")
        message = (
            rf"shape \(3, {columns}\): expected \(n, 12\) to \(n, 14\), with extras \['creep', 'material'\]"
        )
        with pytest.raises(InvalidArgument, match=message):
            predictor.predict(np.ones((3, columns), np.float32))


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        (("effects", 2, "terms", 0, "features", 0), "crepe", r"effect creep takes \['crepe'\]"),
        (("effects", 1, "shift_ticks"), 3, r"manifest\.json: window\.shift 2: expected 3"),
        (("effects", 2, "terms"), [], r"extras \['creep', 'material'\]: no effect takes them"),
        (
            ("window", "extras", 0, "taken_by"),
            "model",
            "normalisation.input_mean has 12 values: expected 13",
        ),
        (("window", "extras", 1, "taken_by"), "model", "those that the model takes before"),
        (("effects", 0, "frame", "force_rotation", 0, 0), 0.5, "expected a rotation"),
        (("window", "shift"), 200, "shift 200: expected at most 100"),
    ],
)
def test_a_manifest_at_odds_with_its_effects_is_refused(
    corrected: Path, path: tuple[str | int, ...], value: object, message: str
) -> None:
    place = corrected / "skin" / "2" / artifacts.MANIFEST
    content = json.loads(place.read_text())
    part = content
    for step in path[:-1]:
        part = part[step]
    part[path[-1]] = value
    place.write_text(json.dumps(content))
    with taxel.load(corrected) as source, pytest.raises(Unavailable, match=message):
        source.predictor("skin", "2")
