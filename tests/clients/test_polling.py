"""Polling stops where replies are slow, and goes on where they are quick."""

import asyncio
from queue import Empty, SimpleQueue
from threading import Timer
from typing import Any, cast

import pytest

from taxel.polling import MOST_A_TURN_S, PollingInLoop
from taxel.remote.first_reply import FirstReply

SLOW_S = 0.05
"""Far above what is polled for."""


class Replies:
    """A channel of replies that counts how often it was asked without waiting."""

    def __init__(self) -> None:
        self.queue: SimpleQueue[str] = SimpleQueue()
        self.asked = 0

    def try_recv(self) -> str | None:
        self.asked += 1
        try:
            return self.queue.get_nowait()
        except Empty:
            return None

    def recv(self) -> str:
        return self.queue.get()


def waited(first: FirstReply, *, slow: bool) -> int:
    """How often a reply was asked for before the thread slept."""
    replies = Replies()
    if slow:
        Timer(SLOW_S, replies.queue.put, ["late"]).start()
    else:
        replies.queue.put("there")
    assert cast("Any", first.wait(cast("Any", replies))) == ("late" if slow else "there")
    return replies.asked


def test_after_a_slow_reply_the_thread_sleeps_at_once() -> None:
    first = FirstReply()
    assert waited(first, slow=True) > 0, "the first reply is polled for"
    assert waited(first, slow=True) == 0
    assert waited(first, slow=False) == 0
    # A quick one that was slept for brings polling back. On a busy machine one may be slow.
    assert any(waited(first, slow=False) == 1 for _ in range(20))


@pytest.mark.parametrize(("took_s", "may"), [(1e-4, True), (3e-4, False)])
def test_an_event_loop_is_held_up_only_where_replies_are_quick(took_s: float, may: bool) -> None:
    async def asked() -> bool:
        polling = PollingInLoop(asyncio.get_running_loop(), 2e-4)
        assert not polling.may_poll(0.0), "nothing is known of the server yet"
        polling.note(took_s)
        return polling.may_poll(0.0)

    assert asyncio.run(asked()) is may


def test_calls_of_one_turn_share_its_time() -> None:
    async def asked() -> list[bool]:
        polling = PollingInLoop(asyncio.get_running_loop(), 2e-4)
        polling.note(1e-4)
        first = [polling.may_poll(at * MOST_A_TURN_S) for at in (0.0, 0.9, 1.1)]
        await asyncio.sleep(0)
        return [*first, polling.may_poll(1.2 * MOST_A_TURN_S)]

    assert asyncio.run(asked()) == [True, True, False, True]
