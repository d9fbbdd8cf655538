"""What this process takes of the machine, and what the system may do with idle cores meanwhile."""

import os
from io import FileIO
from pathlib import Path
from typing import Final

from taxel.errors import SettingsError

_LATENCY: Final = Path("/dev/cpu_dma_latency")


def keep_cores_awake(device: Path = _LATENCY) -> FileIO:
    """Forbid deep sleep to all cores until the file that this returns is closed. Linux only.

    Raises:
        SettingsError: this process may not, or the system has no such device.
    """
    try:
        held = device.open("r+b", buffering=0)
        # Zero microseconds, as a 32-bit number: no core may need longer to wake up.
        held.write(bytes(4))
    except OSError as error:
        raise SettingsError(
            f"--no-halt: {device}: {error.strerror}: expected Linux, and the right to write this device"
        ) from None
    return held


def resident_bytes() -> int:
    """The memory that this process holds now; 0 where the system does not tell."""
    try:
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    except OSError:
        return 0
    return pages * os.sysconf("SC_PAGE_SIZE")
