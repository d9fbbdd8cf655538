"""Which updates a viewer gets: it never has more of them than it can draw, and none waits in a queue.

An update is made only at the moment it can be sent, from the newest data. While a viewer is busy, updates
are dropped; the next one carries what its strip charts have missed.
"""

from typing import Final

IN_FLIGHT: Final = 2
"""The most updates sent and not yet drawn: one on its way while another is drawn."""


class Pacing:
    """Counts the updates of one viewer.

    Attributes:
        sent: updates that the viewer got.
        drawn: how many of them it has drawn.
        dropped: updates that were due while it was busy.
    """

    def __init__(self) -> None:
        self.sent = 0
        self.drawn = 0
        self.dropped = 0

    def may_send(self) -> bool:
        """Whether an update that is due now may be sent; if not, it is dropped."""
        if self.sent - self.drawn < IN_FLIGHT:
            return True
        self.dropped += 1
        return False

    def note_sent(self) -> None:
        """An update was sent."""
        self.sent += 1

    def note_drawn(self) -> None:
        """The viewer has drawn one more. It cannot have drawn what it did not get."""
        self.drawn = min(self.drawn + 1, self.sent)
