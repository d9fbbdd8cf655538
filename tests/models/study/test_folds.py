"""Folds: what is tested once, what never leaks, and the published choices."""

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from taxel.errors import SettingsError
from taxel.windows import WindowSpec, build_windows
from taxel_models.recordings import Recording
from taxel_models.study.fold_data import fold_data
from taxel_models.study.folds import GUARD, Fold, Partition, choose_grouping, partition
from taxel_models.training.split import groups_of

Make = Callable[..., Recording]
several = settings(
    suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=20, deadline=None
)


def touched(divided: Partition, numbers: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Whether the widest window of any of these reads a tick; all recordings one after the other."""
    ends = np.cumsum([0, *map(len, divided.recordings)])
    rows = np.concatenate([rows + start for rows, start in zip(divided.rows, ends[:-1], strict=True)])
    read = np.zeros(ends[-1], bool)
    for step in range(-GUARD, GUARD + 1):
        read[rows[numbers] + step] = True
    return read


def parts(fold: Fold) -> tuple[NDArray[np.int64], ...]:
    return fold.train, fold.validation, fold.test


@several
@given(st.lists(st.integers(25, 1700), min_size=20, max_size=30), st.integers(2, 5), st.integers(0, 9))
def test_strict_lets_no_window_touch_another_part(
    make_recording: Make, segment_rows: list[int], folds: int, seed: int
) -> None:
    recording = make_recording(segment_rows)
    divided = partition("strict", [recording], "chunks", folds, seed)
    for fold in divided.folds:
        assert (sum(touched(divided, part).astype(int) for part in parts(fold)) <= 1).all()
        assert fold.statistics is fold.train


@several
@given(st.lists(st.integers(30, 400), min_size=20, max_size=40), st.integers(2, 10), st.integers(0, 9))
def test_strict_tests_every_trial_whole_and_once(
    make_recording: Make, segment_rows: list[int], folds: int, seed: int
) -> None:
    recording = make_recording(segment_rows)
    divided = partition("strict", [recording], "trials", folds, seed)
    tested: list[int] = []
    for fold in divided.folds:
        rows = [set(divided.rows[0][part].tolist()) for part in parts(fold)]
        for segment in recording.segments:
            whole = set(range(segment.start + GUARD, segment.stop - GUARD))
            assert sum(whole <= part for part in rows) == 1
        tested += fold.test.tolist()
    assert sorted(tested) == list(range(len(divided.rows[0])))
    tests = [len(fold.validation) > 0 for fold in divided.folds]
    assert all(tests)


def test_sessions_are_held_out_whole(make_recording: Make) -> None:
    sessions = [make_recording([700], seed) for seed in range(4)]
    assert choose_grouping(sessions, "auto", 4) == "sessions"
    divided = partition("strict", sessions, "sessions", 4, 0)
    owner = np.repeat(np.arange(4), [len(rows) for rows in divided.rows])
    for fold in divided.folds:
        owners = [set(owner[part].tolist()) for part in parts(fold)]
        assert len(owners[2]) == len(owners[1]) == 1
        assert len(owners[0] | owners[1] | owners[2]) == 4


def test_auto_takes_trials_where_there_are_any(make_recording: Make) -> None:
    trials, continuous = make_recording([100] * 25), make_recording([5000])
    assert choose_grouping([trials], "auto", 10) == "trials"
    assert choose_grouping([continuous], "auto", 10) == "chunks"
    assert choose_grouping([trials, continuous], "chunks", 10) == "chunks"
    with pytest.raises(SettingsError, match="choose --unit"):
        choose_grouping([trials, continuous], "auto", 10)


def test_the_published_folds_of_the_published_length(make_recording: Make) -> None:
    recording = make_recording([292_200])
    divided = partition("paper", [recording], "chunks", 10, 0)
    chunk = 1000 - 2 * GUARD
    assert [len(fold.test) // chunk for fold in divided.folds] == [30] * 9 + [22]
    tested = np.concatenate([fold.test for fold in divided.folds])
    assert len(np.unique(tested)) == len(tested) == 292 * chunk
    for fold in divided.folds:
        assert len(fold.validation) == 30 * chunk
        np.testing.assert_array_equal(np.sort(fold.statistics), np.sort(tested))
    # 80/10/10, less what the guards take.
    shares = np.array([len(part) for part in parts(divided.folds[0])]) / 292_200
    np.testing.assert_allclose(shares, [0.8, 0.1, 0.1], atol=0.03)


def test_the_published_guards_keep_windows_apart(make_recording: Make) -> None:
    divided = partition("paper", [make_recording([13_500]), make_recording([9_300], 1)], "chunks", 4, 2)
    for fold in divided.folds:
        assert (sum(touched(divided, part).astype(int) for part in parts(fold)) <= 1).all()


def test_the_paper_ignores_gaps_and_strict_does_not(make_recording: Make) -> None:
    recording = make_recording([2500] * 4)
    divided = partition("paper", [recording], "chunks", 3, 0)
    reads_across = [
        row
        for row in divided.rows[0].tolist()
        if any(abs(row - edge) < GUARD for edge in (2500, 5000, 7500))
    ]
    assert reads_across
    strict = partition("strict", [recording], "chunks", 3, 0)
    assert not set(reads_across) & set(strict.rows[0].tolist())


def test_the_seed_decides(make_recording: Make) -> None:
    recording = make_recording([100] * 40)
    first, again, other = (partition("strict", [recording], "trials", 5, seed) for seed in (1, 1, 2))
    for fold, repeated in zip(first.folds, again.folds, strict=True):
        np.testing.assert_array_equal(fold.test, repeated.test)
        np.testing.assert_array_equal(fold.validation, repeated.validation)
    assert any(not np.array_equal(a.test, b.test) for a, b in zip(first.folds, other.folds, strict=True))


@pytest.mark.parametrize(("protocol", "rows"), [("strict", 3000), ("paper", 900), ("paper", 5000)])
def test_too_little_data_is_refused(make_recording: Make, protocol: str, rows: int) -> None:
    with pytest.raises(SettingsError, match="too few"):
        partition(protocol, [make_recording([rows])], "chunks", 5, 0)  # type: ignore[arg-type]


def test_units_of_sessions_are_whole_recordings(make_recording: Make) -> None:
    assert groups_of([make_recording([50, 60])], "sessions") == [(0, slice(0, 110))]


@pytest.mark.parametrize("combination", [1, 3, 8])
def test_fold_data_are_the_windows_of_the_fold_in_z_scores(make_recording: Make, combination: int) -> None:
    recordings = [make_recording([400] * 25, seed) for seed in (1, 2)]
    divided = partition("strict", recordings, "trials", 5, 0)
    data = fold_data(divided, combination, 2)
    spec = WindowSpec.of(combination)
    windows, channels = [], []
    for recording, rows in zip(recordings, divided.rows, strict=True):
        built = build_windows(recording.samples, spec)
        kept = np.isin(built.rows, rows)
        windows.append(built.values[kept])
        channels.append(recording.channels[rows])
    fold = divided.folds[2]
    raw, counts = np.concatenate(windows), np.concatenate(channels)
    mean, std = raw[fold.train].mean(axis=0), raw[fold.train].std(axis=0)
    np.testing.assert_allclose(data.test.windows, (raw[fold.test] - mean) / std, atol=2e-4)
    np.testing.assert_array_equal(data.measured, counts[fold.test])
    np.testing.assert_allclose(data.scaler.restore(data.test.channels), data.measured, rtol=1e-5)
    np.testing.assert_allclose(data.train.channels.mean(axis=0), 0, atol=1e-3)
    np.testing.assert_allclose(data.train.channels.std(axis=0), 1, atol=1e-3)
    assert data.windows == {
        "train": len(fold.train),
        "validation": len(fold.validation),
        "test": len(fold.test),
    }
