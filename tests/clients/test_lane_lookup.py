"""When a client without a lane looks for one."""

from typing import Any

import pytest

from taxel.errors import Unavailable
from taxel.lane import lookup
from taxel.lane.lookup import LaneLookup


class Server:
    """Tells the same metadata each time, and counts how often it was asked."""

    def __init__(self, metadata: Any) -> None:
        self.metadata = metadata
        self.asked = 0

    def tell(self) -> Any:
        self.asked += 1
        if isinstance(self.metadata, Exception):
            raise self.metadata
        return self.metadata


@pytest.mark.parametrize(
    ("metadata", "looks"),
    [
        ({"name": "taxel"}, 9),
        ({"lane": {"address": "tcp:127.0.0.1:1", "machine": "another"}}, 9),
        (Unavailable("nobody answers"), 300),
    ],
)
def test_it_looks_ever_less_often_while_the_server_answers(
    monkeypatch: pytest.MonkeyPatch, metadata: Any, looks: int
) -> None:
    now = [0.0]
    monkeypatch.setattr(lookup.time, "monotonic", lambda: now[0])
    server = Server(metadata)
    # In 300 s: at 0, 2, 6, 14, 30, 62 s and then each minute; or each second.
    lanes = LaneLookup(server.tell)
    for tenth in range(3000):
        now[0] = tenth / 10
        assert lanes.find() is None
    assert server.asked == looks
    lanes.close()
    now[0] += 1000
    assert lanes.find() is None
    assert server.asked == looks
