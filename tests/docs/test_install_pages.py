"""Pages that install Taxel are followed in a new environment, with the wheel of this checkout."""

from pathlib import Path

import pytest

from .following import INSTALLING, Follower, in_turn
from .installing import new_environment


@pytest.fixture(scope="module")
def new(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """One environment for all these pages: what the server compiles there takes half a minute."""
    return new_environment(tmp_path_factory.mktemp("new"))


@pytest.mark.parametrize("page", in_turn(INSTALLING))
def test_a_page_can_be_followed_with_the_wheel(page: str, new: dict[str, str], tmp_path: Path) -> None:
    """What it installs is the wheel, with extras that exist; then its commands and examples work."""
    with Follower(tmp_path, variables=new) as follower:
        follower.follow(page)
        follower.python("import taxel; print(taxel.__file__)", page)
        assert Path(follower.printed.strip()).is_relative_to(Path(new["PATH"].partition(":")[0]).parent)
