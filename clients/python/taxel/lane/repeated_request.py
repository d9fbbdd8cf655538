"""Requests of a control loop, all of whose bytes but the windows are made once."""

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from taxel.channels import CHANNELS
from taxel.lane.frames import HEAD_BYTES, ID_AT, ID_END, pack_predictions, pack_request_head

_SAME_BYTES: Final = 20
"""The first bytes of replies with the same number of counts to requests with the same id are the same."""

_FLOAT: Final = np.dtype(np.float32)
_WIRE_FLOAT: Final = np.dtype("<f4")


class RepeatedRequest:
    """Requests of a control loop, which differ only in their windows: all other bytes are made once.

    Each has a connection to itself, so their ids need not differ.

    Args:
        path: of the requests, such as `v2/models/xgb/infer`.
        shape: (n, f) of their windows.
        timeout_s: the deadline that the server is told.
        wait_s: how long an answer is waited for.

    Attributes:
        head: the bytes before the windows.
        reply_head: the first bytes of a reply with counts, up to what differs.
        reply_size: bytes of such a reply.
        before, after: `head` before and after the id, for connections that several calls share.
    """

    def __init__(self, path: str, shape: tuple[int, ...], timeout_s: float, wait_s: float) -> None:
        self.head = pack_request_head(path, 1, shape, timeout_s * 1e3, spread=False)
        reply = pack_predictions(1, np.zeros((shape[0], len(CHANNELS)), np.float32), 0, 0, 0)
        self.shape = shape
        self.before, self.after = self.head[:ID_AT], self.head[ID_END:]
        self.reply_head = reply[:_SAME_BYTES]
        self._reply_before, self._reply_after = reply[:ID_AT], reply[ID_END:_SAME_BYTES]
        self.reply_size = len(reply)
        self.wait_s = wait_s
        self._counts_shape = shape[0], len(CHANNELS)

    def takes(self, windows: NDArray[Any]) -> bool:
        """Whether windows of its shape can be sent as they are. The server checks that they are finite."""
        return type(windows) is np.ndarray and windows.dtype is _FLOAT

    def counts_for(self, reply: bytes) -> NDArray[np.float32] | None:
        """As `counts_in`, whatever the id of the request was."""
        if (
            len(reply) == self.reply_size
            and reply.startswith(self._reply_before)
            and reply.startswith(self._reply_after, ID_END)
        ):
            return np.ndarray(self._counts_shape, _WIRE_FLOAT, reply, HEAD_BYTES).copy()
        return None

    def counts_in(self, reply: bytes) -> NDArray[np.float32] | None:
        """The counts (n, 21) of a reply; None if it is another one, or not all of it."""
        if len(reply) == self.reply_size and reply.startswith(self.reply_head):
            return np.ndarray(self._counts_shape, _WIRE_FLOAT, reply, HEAD_BYTES).copy()
        return None
