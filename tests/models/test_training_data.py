"""The split holds out whole groups, and no window reaches from one part into another."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from taxel.errors import SettingsError
from taxel.windows import COMBINATIONS, WindowSpec, build_windows
from taxel_models.recordings import Recording
from taxel_models.training.dataset import Dataset, examples
from taxel_models.training.split import CHUNK_ROWS, SplitSettings, Subset, split

Make = Callable[..., Recording]
several = settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=25)


@several
@given(st.lists(st.integers(30, 2500), min_size=20, max_size=40), st.integers(0, 99))
def test_trials_are_held_out_whole(make_recording: Make, segment_rows: list[int], seed: int) -> None:
    recording = make_recording(segment_rows)
    (parts,) = split([recording], SplitSettings("auto", seed=seed))
    of_segment = [set(parts[segment].tolist()) for segment in recording.segments]
    assert all(len(found) == 1 for found in of_segment)
    tests = sum(found == {Subset.TEST} for found in of_segment)
    validations = sum(found == {Subset.VALIDATION} for found in of_segment)
    assert tests == validations == round(0.1 * len(segment_rows))


@several
@given(st.lists(st.integers(30, 6000), min_size=4, max_size=8), st.integers(0, 99))
def test_chunks_are_held_out_whole(make_recording: Make, segment_rows: list[int], seed: int) -> None:
    recording = make_recording(segment_rows)
    (parts,) = split([recording], SplitSettings("chunks", seed=seed))
    for segment in recording.segments:
        for start in range(segment.start, segment.stop, CHUNK_ROWS):
            assert len(set(parts[start : min(start + CHUNK_ROWS, segment.stop)].tolist())) == 1
    assert set(parts.tolist()) == {0, 1, 2}


def test_the_seed_decides(make_recording: Make) -> None:
    recording = make_recording([100] * 40)
    first, again, other = (split([recording], SplitSettings("trials", seed=s))[0] for s in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert (first != other).any()


@pytest.mark.parametrize("combination", COMBINATIONS)
def test_no_sample_serves_two_parts(make_recording: Make, combination: int) -> None:
    recording = make_recording([5300, 4100])
    spec = WindowSpec.of(combination)
    data = Dataset.of([recording], spec, SplitSettings("chunks", seed=3))
    (parts,) = split([recording], SplitSettings("chunks", seed=3))
    # The parts' windows are exactly those of each part's rows taken as recordings of their own.
    for part, found in (
        (Subset.TRAIN, data.train),
        (Subset.VALIDATION, data.validation),
        (Subset.TEST, data.test),
    ):
        alone = examples(recording.rows(parts == part), spec)
        np.testing.assert_array_equal(found.windows, alone.windows)
        np.testing.assert_array_equal(found.channels, alone.channels)
    assert sum(data.counts().values()) < len(build_windows(recording.samples, spec)) or not (
        spec.look_back + spec.look_ahead
    )


def test_the_test_rows_come_back_as_recordings(make_recording: Make) -> None:
    recordings = [make_recording([900] * 25, seed) for seed in (1, 2)]
    spec = WindowSpec.of(1)
    data = Dataset.of(recordings, spec, SplitSettings(seed=1))
    windows = np.concatenate([examples(recording, spec).windows for recording in data.kept.test])
    np.testing.assert_array_equal(windows, data.test.windows)


def test_the_reference_has_all_rows_that_nothing_was_fitted_to(make_recording: Make) -> None:
    recordings = [make_recording([900] * 25, seed) for seed in (1, 2)]
    data = Dataset.of(recordings, WindowSpec.of(1), SplitSettings(seed=1))
    for whole, test, reference in zip(recordings, data.kept.test, data.kept.reference, strict=True):
        known = np.isin(reference.samples.time_ns, test.samples.time_ns)
        assert known.sum() == len(test) < len(reference) < len(whole)
    rest = [examples(recording, WindowSpec.of(1)) for recording in data.kept.reference]
    assert sum(len(one.windows) for one in rest) == len(data.test) + len(data.validation)


def test_what_was_fitted_and_what_was_not_are_all_rows(make_recording: Make) -> None:
    recordings = [make_recording([900] * 25, seed) for seed in (1, 2)]
    data = Dataset.of(recordings, WindowSpec.of(1), SplitSettings(seed=1))
    for whole, *parts in zip(recordings, data.kept.reference, data.kept.fitted, strict=True):
        times = np.concatenate([part.samples.time_ns for part in parts])
        np.testing.assert_array_equal(np.sort(times), whole.samples.time_ns)
    windows = [examples(recording, WindowSpec.of(1)).windows for recording in data.kept.fitted]
    np.testing.assert_array_equal(np.concatenate(windows), data.train.windows)


def test_the_kinds_of_the_training_set_are_kept(make_recording: Make) -> None:
    rows = [100] * 40
    first, second = make_recording(rows), make_recording(rows)
    material = np.repeat(np.arange(40.0) % 3, 100)
    columns = {"material": material, "session": material // 2, "speed": material / 3}
    first = replace(first, covariates=columns)
    second = replace(second, covariates={"material": material + 2, "session": material})
    data = Dataset.of([first, second], WindowSpec.of(1), SplitSettings())
    assert data.contacts.kinds == {"material": (0.0, 1.0, 2.0, 3.0, 4.0)}
    only = Dataset.of([second, make_recording(rows)], WindowSpec.of(1), SplitSettings())
    assert only.contacts.kinds == {}


def test_too_little_to_split_is_refused(make_recording: Make) -> None:
    with pytest.raises(SettingsError, match="too few"):
        split([make_recording([1500])], SplitSettings())


def test_segments_shorter_than_a_window_are_refused(make_recording: Make) -> None:
    with pytest.raises(SettingsError, match="no window"):
        Dataset.of([make_recording([15] * 30)], WindowSpec.of(1), SplitSettings())


@pytest.mark.parametrize(("test", "validation"), [(0, 0.1), (0.5, 0.5), (-0.1, 0.2), (0.1, 1.2)])
def test_shares_that_leave_a_part_empty_are_refused(test: float, validation: float) -> None:
    with pytest.raises(SettingsError, match="expected shares"):
        SplitSettings(test=test, validation=validation)
