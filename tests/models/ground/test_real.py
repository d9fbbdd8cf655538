"""Grounds of real recordings: a round is played on trials that the model was not trained on."""

import pickle
from pathlib import Path

import numpy as np
import pytest

from taxel.channels import CHANNELS
from taxel.errors import RecordingError
from taxel_models.families.xgb import XgbModel
from taxel_models.ground.base_model import BaseModel
from taxel_models.ground.ground import Clean, predicted
from taxel_models.ground.real import SLIDE, STRETCH, RealGround, estimated_place, read_lasa
from taxel_models.ground.twins import StoredModel
from taxel_models.recordings import read_slide
from taxel_models.recordings.lasa import read_lasa_columns
from taxel_models.recovery.chosen_ground import ChosenGround
from taxel_models.shipped import shipped_repository
from taxel_models.twin.sensor import Sensor

pytestmark = pytest.mark.measured


@pytest.fixture(scope="module")
def few_materials(data_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three materials of the slide data, by links."""
    return linked(data_folder, tmp_path_factory.mktemp("data"), "mat5", "mat6", "mat7")


def linked(data_folder: Path, folder: Path, *materials: str) -> Path:
    (folder / SLIDE).mkdir()
    for material in materials:
        (folder / SLIDE / material).symlink_to(data_folder / SLIDE / material)
    return folder


@pytest.fixture(scope="module")
def slide(few_materials: Path) -> RealGround:
    return RealGround.slide(few_materials, seed=1, jobs=2)


@pytest.fixture(scope="module")
def lasa(data_folder: Path) -> RealGround:
    return RealGround.lasa(data_folder, seed=1, jobs=2)


def error(clean: Clean) -> float:
    """Of the live channels, over what the mean would leave; the mean of absolute errors."""
    counts, rows = predicted(clean.model, clean.recording)
    measured = clean.recording.channels[rows]
    live = np.array(clean.live)
    errors = np.abs(measured - counts).mean(axis=0) / np.abs(measured - measured.mean(axis=0)).mean(axis=0)
    return float(errors[live].mean())


def test_slide_trials_are_held_out_whole(slide: RealGround, few_materials: Path) -> None:
    clean = slide.clean(0)
    everything = read_slide(few_materials / SLIDE).ticks()
    fingerprint = clean.model.manifest.training
    assert fingerprint is not None
    trained = fingerprint.data[0].rows
    played = sum(len(session.played) for session in slide.sessions)
    assert trained + played <= len(everything)
    assert len(clean.recording.segments) == int(clean.contact.max()) + 1 <= 50
    # A trial that is played is there from its first row to its last.
    starts = {
        int(everything.samples.time_ns[part.start]): part.stop - part.start for part in everything.segments
    }
    for part in clean.recording.segments:
        assert starts[int(clean.recording.samples.time_ns[part.start])] == part.stop - part.start
    assert clean.reference is not None
    assert clean.fitted is not None
    assert len(clean.reference) + len(clean.fitted) == trained
    for others in (clean.reference, clean.fitted):
        assert not set(others.samples.time_ns.tolist()) & set(clean.recording.samples.time_ns.tolist())
    assert not clean.on_skin
    assert clean.live == (True,) * 21


def test_the_base_model_fits_what_it_did_not_see(slide: RealGround, lasa: RealGround) -> None:
    assert error(slide.clean(0)) < 0.75
    assert error(lasa.clean(0)) < 0.6
    clean = slide.clean(0)
    assert clean.reference is not None
    assert clean.fitted is not None
    errors = []
    for part in (clean.reference, clean.fitted):
        counts, rows = predicted(clean.model, part)
        errors.append(part.channels[rows] - counts)
    np.testing.assert_allclose(np.concatenate(errors).mean(axis=0), 0.0, atol=0.05)


def test_a_base_model_answers_as_its_boosters_do(lasa: RealGround) -> None:
    """It predicts with all of them in one."""
    clean = lasa.clean(0)
    assert isinstance(clean.model, BaseModel)
    fitted = clean.model.trained.fitted
    assert isinstance(fitted, XgbModel)
    rows = np.random.default_rng(0).normal(size=(300, len(clean.model.manifest.window.features)))
    windows = rows.astype(np.float32)
    for some in (windows, windows[:1], windows[:0]):
        np.testing.assert_array_equal(fitted.predict(some), XgbModel(fitted.boosters).predict(some))


def test_rounds_take_turns_over_base_models(data_folder: Path, lasa: RealGround) -> None:
    told: list[str] = []
    shipped = StoredModel(shipped_repository(), "network-b")
    several = ChosenGround("lasa", 1, shipped, data=data_folder, jobs=2, models=2).prepare(told.append)
    assert told == ["base model 1 of 2", "base model 2 of 2"]
    rounds = [several.clean(number) for number in range(4)]
    assert [clean.base_model for clean in rounds] == [0, 1, 0, 1]
    trained = {clean.model.manifest.model_file.sha256 for clean in rounds[:2]}
    assert len(trained) == 2
    # The first model is the one that it would be alone.
    assert rounds[0].recording.fingerprint == lasa.clean(0).recording.fingerprint


def test_rounds_differ_and_repeat(slide: RealGround, lasa: RealGround) -> None:
    for ground in (slide, lasa):
        there: RealGround = pickle.loads(pickle.dumps(ground))
        first, second = ground.clean(3), there.clean(3)
        assert first.recording.fingerprint == second.recording.fingerprint
        (counts, _), (others, _) = (predicted(one.model, one.recording) for one in (first, second))
        np.testing.assert_array_equal(counts, others)
        assert len({ground.clean(number).recording.fingerprint for number in range(6)}) > 3


def test_a_round_may_play_one_material(few_materials: Path) -> None:
    ground = RealGround.slide(few_materials, seed=1, jobs=2, one_of="material")
    played = [ground.clean(number).recording.covariates["material"] for number in range(6)]
    assert {len(set(materials.tolist())) for materials in played} == {1}
    assert {materials[0] for materials in played} == {5.0, 6.0, 7.0}
    with pytest.raises(
        RecordingError, match=r"no column 'colour' to play one value of; there are: material"
    ):
        RealGround.slide(few_materials, seed=1, jobs=2, one_of="colour")


def test_a_model_may_not_have_seen_what_is_played(few_materials: Path) -> None:
    ground = RealGround.slide(few_materials, seed=1, jobs=2, one_of="material", unseen=True)
    played = {ground.clean(number).recording.covariates["material"][0] for number in range(4)}
    assert len(played) == 1
    training = ground.sessions[0].model.manifest.training
    assert training is not None
    assert training.contacts is not None
    assert {*training.contacts.kinds["material"], *played} == {5.0, 6.0, 7.0}
    assert len(training.contacts.kinds["material"]) == 2


def test_a_round_may_play_all_days(data_folder: Path, tmp_path: Path) -> None:
    """Material 1 is from another day than materials 2 and 3."""
    folder = linked(data_folder, tmp_path, "mat1", "mat2", "mat3")
    ground = RealGround.slide(folder, seed=1, jobs=2, all_days=True)
    played = ground.clean(0).recording
    assert set(played.covariates["material"].tolist()) == {1.0, 2.0, 3.0}


def test_a_round_may_play_some_materials_that_training_never_had(few_materials: Path) -> None:
    ground = RealGround.slide(few_materials, seed=1, jobs=2, unseen=True)
    training = ground.sessions[0].model.manifest.training
    assert training is not None
    assert training.contacts is not None
    known = set(training.contacts.kinds["material"])
    played = set(ground.clean(0).recording.covariates["material"].tolist())
    assert len(known) == 2
    assert known < played == {5.0, 6.0, 7.0}


def test_lasa_is_cut_into_stretches_with_places_on_the_skin(data_folder: Path, lasa: RealGround) -> None:
    recording = read_lasa(data_folder / "lasa_contact", "F2", seed=0)
    lengths = [part.stop - part.start for part in recording.segments]
    assert max(lengths) < STRETCH
    assert len(lengths) == 48
    force, electrodes = read_lasa_columns(data_folder / "lasa_contact", "F2")
    place = estimated_place(electrodes, np.linalg.norm(force, axis=1)) * 1e3
    axis = np.minimum(place[:, 0], 0.0)
    radius = np.linalg.norm(place - np.column_stack([axis, np.zeros((len(axis), 2))]), axis=1)
    np.testing.assert_allclose(radius, Sensor.biotac_2p().skin_radius)
    assert not lasa.live[CHANNELS.index("pdc")]


def test_a_folder_without_recordings_is_told(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="no such folder; expected the real recordings"):
        RealGround.slide(tmp_path, seed=0)
