"""What needs real recordings is followed with a few of them: pages of results, and single lines."""

from pathlib import Path
from typing import Final

import pytest

from .blocks import ALL, joined_lines
from .following import Follower
from .given import ELSEWHERE, FEW, MEASURED

pytestmark = [pytest.mark.measured, pytest.mark.long]

LINES: Final = [
    (block.page, line)
    for block in ALL
    if block.language == "sh"
    for line in joined_lines(block.text)
    if "test_measured_pages.py" in "".join(by for begin, by in ELSEWHERE.items() if line.startswith(begin))
]


@pytest.fixture
def beside_few(data_folder: Path, tmp_path: Path) -> Path:
    """A folder with three materials of the slide data, some trials of them, and LASA's recordings."""
    few, slide = tmp_path / FEW, "biotac_slide"
    (few / slide).mkdir(parents=True)
    for material in ("mat5", "mat6", "mat7"):
        whole = (data_folder / slide / material).resolve()
        (few / slide / material).symlink_to(whole)
        some = few / "trials" / slide / material
        some.mkdir(parents=True)
        for file in whole.glob(f"{material}_1?_*"):
            (some / file.name).symlink_to(file)
    (few / "lasa_contact").symlink_to((data_folder / "lasa_contact").resolve())
    return tmp_path


@pytest.mark.parametrize("page", MEASURED)
def test_a_page_of_results_can_be_followed(page: str, beside_few: Path) -> None:
    with Follower(beside_few) as follower:
        follower.follow(page)


@pytest.mark.parametrize(("page", "line"), LINES, ids=[page for page, _ in LINES])
def test_a_line_runs_on_recordings(page: str, line: str, beside_few: Path) -> None:
    with Follower(beside_few) as follower:
        follower.lines([line], page)
