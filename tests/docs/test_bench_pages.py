"""Pages of measurements are followed."""

import pytest

from .following import MEASURING, Follower

pytestmark = pytest.mark.long


@pytest.mark.parametrize("page", MEASURING)
def test_a_page_can_be_followed(page: str, follower: Follower) -> None:
    """The commands and examples of a page work one after the other, and print what the page shows."""
    follower.follow(page)
