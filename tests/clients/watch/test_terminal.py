"""The picture in a terminal, read back."""

import io
from collections import deque
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console
from rich.style import Style

from taxel_watch.colours import LIMIT, STOPS, Theme, colours_of
from taxel_watch.replay import Replay
from taxel_watch.terminal import Terminal, draw, electrode_at, skin_text, strip

THEMES: tuple[Theme, ...] = ("light", "dark")


@pytest.mark.parametrize("theme", THEMES)
def test_the_scale_goes_from_one_end_over_rest_to_the_other(theme: Theme) -> None:
    ends = colours_of(np.array([-2.0 * LIMIT, -LIMIT, 0.0, LIMIT, 2.0 * LIMIT]), theme)
    below, above = STOPS[theme]["below"], STOPS[theme]["above"]
    assert ends.tolist() == [below[-1], below[-1], below[0], above[-1], above[-1]]
    # A sixteenth of the limit is a quarter of the way.
    assert colours_of(np.array([LIMIT / 16]), theme).tolist() == [above[1]]


@pytest.mark.parametrize("theme", THEMES)
def test_more_counts_are_further_from_rest_for_any_eye(theme: Theme) -> None:
    for values in (np.linspace(0, LIMIT, 50), -np.linspace(0, LIMIT, 50)):
        lightness = colours_of(values, theme) @ [0.2126, 0.7152, 0.0722]
        steps = np.diff(lightness)
        assert (steps <= 0.5).all() if theme == "light" else (steps >= -0.5).all()


def test_every_electrode_has_its_part_of_the_map() -> None:
    grid = electrode_at()
    assert set(np.unique(grid)) == set(range(-1, 19))
    # e2 is left of e12, e7 above e19.
    columns = [np.nonzero(grid == electrode)[1].mean() for electrode in (1, 11)]
    rows = [np.nonzero(grid == electrode)[0].mean() for electrode in (6, 18)]
    assert columns[0] < columns[1]
    assert rows[0] < rows[1]


def test_cells_have_the_colours_of_their_counts() -> None:
    values = np.linspace(-900.0, 500.0, 19)
    values[4] = np.nan
    grid, colours = electrode_at(), colours_of(np.nan_to_num(values), "dark")
    lines = skin_text(values).split("\n")[:13]
    for row, line in enumerate(lines):
        for column in range(grid.shape[1]):
            style = line.get_style_at_offset(Console(), column)
            upper, lower = grid[2 * row, column], grid[2 * row + 1, column]
            if upper >= 0 and upper == lower and upper != 4:
                assert seen(style) == [tuple(colours[upper])] * 2


def seen(style: Style) -> list[Any]:
    parts = (style.color, style.bgcolor)
    return [
        tuple(part.triplet) if part is not None and part.triplet is not None else None for part in parts
    ]


@given(st.lists(st.floats(-1e4, 1e4) | st.just(float("nan")), min_size=1, max_size=20))
def test_a_strip_has_a_bar_for_each_value(values: list[float]) -> None:
    assert len(strip(deque(values))) == len(values)


def test_a_strip_rises_with_the_values() -> None:
    assert strip(deque([0.0, 4.0, 8.0])) == " ▄█"


def test_the_picture_tells_force_counts_and_residual(paced: Replay) -> None:
    player = paced.player()
    player.command("seek", 5.0)
    player.command("pause", 0)
    console = Console(file=io.StringIO(), width=120)
    console.print(Terminal(player).picture())
    told = console.file.getvalue()  # type: ignore[attr-defined]
    assert "left · thumb" in told
    assert "left · index" in told
    assert f"{np.linalg.norm([0.2, 0.4, 2.0]):.2f} N" in told
    assert "pdc     +240" in told
    assert "predicted: 60 counts RMS" in told
    assert "corrected: 8 counts RMS" in told
    assert "paused   100 Hz   p50 50 µs, p99 90 µs   predicted here" in told


def test_it_draws_again_and_again(paced: Replay, clock: Any) -> None:
    console = Console(file=io.StringIO(), width=120)
    draw(paced.player(), console, pictures=2)
    assert "two.csv" in console.file.getvalue()  # type: ignore[attr-defined]
