"""Spectral lines are as rare in noise as their chance says, and a wave's frequency is found."""

from typing import Final

import numpy as np
import pytest

from taxel_models.loop.spectral_lines import coherence, find_lines, sharpest

TICK: Final = 0.01


def test_chance_is_what_it_says() -> None:
    """Lines of noise with a steep spectrum are as rare as their chance."""
    random = np.random.default_rng(0)
    steps = random.normal(size=(6_000, 400))
    red = np.zeros_like(steps)
    for row in range(1, len(red)):
        red[row] = 0.9 * red[row - 1] + steps[row]
    test = find_lines(red, [slice(0, 2_500), slice(2_600, 6_000)])
    assert test is not None
    chance = test.p_value[6:120]
    for level in (1e-2, 1e-3):
        assert (chance < level).mean() <= 2.0 * level
    assert (chance < 1e-2).mean() >= 0.2e-2


def test_without_a_whole_piece_there_are_no_lines() -> None:
    assert find_lines(np.zeros((300, 2)), [slice(0, 200), slice(200, 300)]) is None


def test_the_sharpest_wave_is_between_the_ends() -> None:
    segment = np.repeat(np.arange(3), 800)
    time = TICK * np.arange(2_400)
    rows = np.ones(2_400, bool)
    wave = np.sin(2 * np.pi * 4.37 * time)[:, None]
    assert sharpest(wave, segment, rows, 4.0, 4.8) == pytest.approx(4.37, abs=0.005)
    assert sharpest(wave, segment, rows, 4.4, 4.8) is None


def test_waves_with_one_phase_between_them_are_coherent() -> None:
    random = np.random.default_rng(0)
    pieces = [slice(start, start + 256) for start in range(0, 20 * 256, 256)]
    time = TICK * np.arange(256)
    phases = random.random((20, 2))
    first, second = (
        np.concatenate([np.sin(2 * np.pi * (7.3 * time + phase)) for phase in phases[:, column]])
        for column in range(2)
    )
    noise = 0.1 * random.normal(size=(2, 20 * 256))
    delayed = np.concatenate([np.sin(2 * np.pi * (7.3 * time + phase + 0.2)) for phase in phases[:, 0]])
    share, count = coherence(
        (first + noise[0])[:, None], np.column_stack([3.0 * delayed, second, noise[1]]), pieces, 7.3
    )
    assert share.shape == (1, 3)
    assert 15 <= count <= 20
    assert share[0, 0] > 0.98
    assert (share[0, 1:] < 0.3).all()
    assert not coherence(np.zeros((512, 1)), np.ones((512, 1)), [slice(0, 512)], 7.3)[0].any()
