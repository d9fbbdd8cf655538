"""What this process takes of the machine, and what the system may do with idle cores meanwhile."""

import os
from contextlib import suppress
from io import FileIO
from pathlib import Path
from typing import Final

from taxel.errors import SettingsError

_LATENCY: Final = Path("/dev/cpu_dma_latency")

FEWEST_FILES: Final = 64
"""A server opens 20 or so by itself."""

MOST_FILES: Final = 2**16
"""Some programs that a server may start go through all files that there may be."""


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


def allow_open_files() -> None:
    """Let this process open as many files as the system allows it, up to `MOST_FILES`: clients take some.

    Raises:
        SettingsError: a server needs more than it may open.
    """
    most = most_open_files()
    if most < FEWEST_FILES:
        raise SettingsError(
            f"this process may open {most} files: expected {FEWEST_FILES}, and two more for each client; "
            "see `ulimit -n`, or LimitNOFILE= of a service"
        )
    # Windows has no such limit. macOS may have a lower one, which it does not tell.
    with suppress(ImportError, OSError, ValueError):
        import resource

        soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
        if 0 <= soft < most:
            resource.setrlimit(resource.RLIMIT_NOFILE, (most, hard))


def most_open_files() -> int:
    """How many files this process may open if it asks for them."""
    try:
        import resource
    except ImportError:
        return MOST_FILES
    _, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    return MOST_FILES if hard == resource.RLIM_INFINITY else min(hard, MOST_FILES)


def resident_bytes() -> int:
    """The memory that this process holds now; 0 where the system does not tell."""
    try:
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    except OSError:
        return 0
    return pages * os.sysconf("SC_PAGE_SIZE")
