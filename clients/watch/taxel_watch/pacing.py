"""Which frames a viewer gets: it never has more of them than it can draw, and none waits in a queue.

A frame is made only at the moment it can be sent, from the newest data. While a viewer is busy, frames are
dropped; the next one carries what its strip charts have missed.
"""

from typing import Final

IN_FLIGHT: Final = 2
"""The most frames sent and not yet drawn: one on its way while another is drawn."""


class Pacing:
    """Counts the frames of one viewer.

    Attributes:
        sent: frames that the viewer got.
        drawn: how many of them it has drawn.
        dropped: frames that were due while it was busy.
    """

    def __init__(self) -> None:
        self.sent = 0
        self.drawn = 0
        self.dropped = 0

    def may_send(self) -> bool:
        """Whether a frame that is due now may be sent; if not, it is dropped."""
        if self.sent - self.drawn < IN_FLIGHT:
            return True
        self.dropped += 1
        return False

    def note_sent(self) -> None:
        """A frame was sent."""
        self.sent += 1

    def note_drawn(self) -> None:
        """The viewer has drawn one more. It cannot have drawn what it did not get."""
        self.drawn = min(self.drawn + 1, self.sent)
