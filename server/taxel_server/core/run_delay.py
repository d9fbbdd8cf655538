"""How long a thread was ready to run and waited for a processor."""

from pathlib import Path
from threading import Thread


class RunDelay:
    """The run delay of a thread, as Linux counts it.

    Source: Documentation/scheduler/sched-stats.rst of Linux, the second figure of `schedstat`.

    Args:
        thread: one of this process that has been started.
    """

    def __init__(self, thread: Thread) -> None:
        self._file = Path(f"/proc/self/task/{thread.native_id}/schedstat")

    def seconds(self) -> float | None:
        """Since the thread started; None where the system does not tell, or the thread has ended."""
        try:
            return int(self._file.read_bytes().split()[1]) / 1e9
        except (OSError, IndexError, ValueError):
            return None
