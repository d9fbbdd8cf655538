"""Who may queue more: what is queued is counted, in all and for each client.

The rule is that of dynamic thresholds (Choudhury and Hahne, Dynamic Queue Length Thresholds for
Shared-Memory Packet Switches, IEEE/ACM Transactions on Networking 6, 1998): a client may hold as much as
stays free. One client alone gets half of each limit, n clients that want more than they can have get
1 / (n + 1) each in the end, and some room always stays for the next one.
"""

from collections.abc import Hashable
from typing import Final, NamedTuple, Protocol

SMALL_ROWS: Final = 64
"""A request of so many windows is small: a client without other requests may always queue one."""


class Amounts(NamedTuple):
    """What is limited, and what a request takes of it.

    Attributes:
        requests: requests.
        rows: windows.
        bytes: of the requests as they arrived.
        seconds: that their evaluation will probably take.
    """

    requests: int
    rows: int
    bytes: int
    seconds: float


class Claim(Protocol):
    """What asks for a share: a request, with its client and what it takes."""

    client: Hashable
    amounts: Amounts


_NOTHING: Final = Amounts(0, 0, 0, 0.0)


def _plus(some: Amounts, more: Amounts) -> Amounts:
    return Amounts(some[0] + more[0], some[1] + more[1], some[2] + more[2], some[3] + more[3])


def _minus(some: Amounts, less: Amounts) -> Amounts:
    if some[0] == less[0]:
        return _NOTHING  # Sums of seconds are not exact.
    return Amounts(some[0] - less[0], some[1] - less[1], some[2] - less[2], some[3] - less[3])


def _told(amount: float) -> str:
    return str(amount) if isinstance(amount, int) else f"{amount:.3g}"


class Shares:
    """Counts what is taken. One small request of each client comes on top of the limits.

    Args:
        limits: the most that is taken in all, but for these small requests.
    """

    def __init__(self, limits: Amounts) -> None:
        self._limits = limits
        self.taken = _NOTHING
        self._of_clients: dict[Hashable, Amounts] = {}

    @property
    def clients(self) -> int:
        """How many clients have taken something."""
        return len(self._of_clients)

    def of(self, client: Hashable) -> Amounts:
        """What a client has taken."""
        return self._of_clients.get(client, _NOTHING)

    def refusal(self, claim: Claim) -> str | None:
        """Why a client may not take more now; None if it may."""
        wanted, mine = claim.amounts, self.of(claim.client)
        if not self.taken.requests or (not mine.requests and wanted.rows <= SMALL_ROWS):
            return None
        for name, limit, taken, own, more in zip(
            Amounts._fields, self._limits, self.taken, mine, wanted, strict=True
        ):
            if own + more > limit - taken - more:
                return (
                    f"the queue is full: {_told(taken)} of {_told(limit)} {name}, {_told(own)} of them "
                    f"yours; with {_told(more)} more you would have more than is left for others"
                )
        return None

    def take(self, claim: Claim) -> None:
        """Count a request that was accepted."""
        self.taken = _plus(self.taken, claim.amounts)
        self._of_clients[claim.client] = _plus(self.of(claim.client), claim.amounts)

    def give(self, claim: Claim) -> None:
        """Count a request no longer."""
        self.taken = _minus(self.taken, claim.amounts)
        left = _minus(self._of_clients[claim.client], claim.amounts)
        if left.requests:
            self._of_clients[claim.client] = left
        else:
            del self._of_clients[claim.client]
