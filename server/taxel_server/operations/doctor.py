"""What on a machine decides how well Taxel runs there. Each look is short and names a remedy."""

import os
import platform
import shutil
import statistics
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Final, Literal

from taxel import __version__
from taxel.errors import TaxelError
from taxel_server.operations.listeners import listeners_on

Grade = Literal["good", "note", "bad"]

PORT: Final = 7447
"""Taxel's default port. zenoh's routers have the same, ROS 2's `rmw_zenohd` among them."""

_PACKAGES: Final = ("numpy", "eclipse-zenoh", "msgpack", "numba", "llvmlite", "onnx", "onnxruntime")
_CLOCK_SOURCE: Final = Path("/sys/devices/system/clocksource/clocksource0/current_clocksource")
_GOOD_CLOCKS: Final = ("tsc", "arch_sys_counter", "kvm-clock", "hyperv_clocksource_tsc_page")
_LATENCY: Final = Path("/dev/cpu_dma_latency")
_SHARED: Final = Path("/dev/shm")
_SLEEPS: Final = 200
_LATE_US: Final = 300.0
_FEW_FILES: Final = 1024
_LITTLE_SHARED: Final = 128 * 2**20


@dataclass(frozen=True)
class Check:
    """One thing that was looked at.

    Attributes:
        subject: what.
        grade: `bad` keeps Taxel from running, `note` may slow it down.
        found: how it is.
        remedy: what to do; empty if there is nothing to do.
    """

    subject: str
    grade: Grade
    found: str
    remedy: str = ""


def examine(port: int = PORT) -> Iterator[Check]:
    """Look at everything, one after the other."""
    looks: tuple[Callable[[], Check], ...] = (
        _python,
        _packages,
        _processor,
        _cores,
        _compiled_code,
        _clock,
        _timer,
        _idle_cores,
        _open_files,
        _lane_folder,
        _shared_memory,
    )
    for look in looks:
        try:
            yield look()
        except Exception as error:  # one look must not stop the others
            yield Check(look.__name__.strip("_").replace("_", " "), "note", f"cannot be told: {error!r}")
    yield _port(port)


def _python() -> Check:
    found = f"{platform.python_version()}, {platform.machine()}, {platform.system()} {platform.release()}"
    return Check("Python", "good", f"{found}; taxel {__version__} in {sys.prefix}")


def _packages() -> Check:
    versions, missing = [], []
    for name in _PACKAGES:
        try:
            versions.append(f"{name} {version(name)}")
        except PackageNotFoundError:
            missing.append(name)
    if missing:
        found = f"{', '.join(versions)}; missing: {', '.join(missing)}"
        return Check("packages", "note", found, "serving needs pip install 'taxel[server]'")
    return Check("packages", "good", ", ".join(versions))


def _processor() -> Check:
    try:
        from taxel_server.runtimes.compiled.processor import instruction_set
    except ImportError as error:
        return Check("processor", "note", f"compiled code cannot run: {error}", "install taxel[server]")
    used, name = instruction_set(), platform.processor() or platform.machine()
    with suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        name = next(
            (line.partition(":")[2].strip() for line in lines if line.startswith("model name")), name
        )
    if used == "generic":
        return Check("processor", "note", f"{name}: code for any processor", "use one with AVX2 or NEON")
    return Check("processor", "good", f"{name}: code for {used}")


def _cores() -> Check:
    allowed = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    found = f"{allowed} of {os.cpu_count()} may be used; load {os.getloadavg()[0]:.1f}"
    with suppress(OSError):
        quota, period = Path("/sys/fs/cgroup/cpu.max").read_text(encoding="ascii").split()
        if quota != "max":
            found += f"; limited to {int(quota) / int(period):.1f} by the container"
            return Check("cores", "note", found, "a limit stops all threads for milliseconds: set none")
    if allowed < 2:
        return Check("cores", "note", found, "give the server and the simulator a core each")
    if os.getloadavg()[0] > allowed:
        return Check("cores", "note", found, "other programs take the cores")
    return Check("cores", "good", found)


def _compiled_code() -> Check:
    from taxel_server.runtimes.compiled.compiling import cache_folder

    folder = cache_folder()
    if folder is None:
        remedy = "set NUMBA_CACHE_DIR to a folder that can be written, or each start takes half a minute"
        return Check(
            "compiled code",
            "note",
            "nothing can be kept: no folder can be written, or its disk is full",
            remedy,
        )
    files = sum(1 for _ in folder.rglob("*.nbc"))
    state = f"{files} functions" if files else "empty: the first start compiles"
    return Check("compiled code", "good", f"{folder}: {state}")


def _clock() -> Check:
    resolution = time.get_clock_info("monotonic").resolution
    source = ""
    with suppress(OSError):
        source = _CLOCK_SOURCE.read_text(encoding="ascii").strip()
    reads = 10_000
    started = time.perf_counter()
    for _ in range(reads):
        time.perf_counter()
    cost_ns = (time.perf_counter() - started) / reads * 1e9
    found = f"{source or 'source unknown'}, steps of {resolution * 1e9:.0f} ns, {cost_ns:.0f} ns to read"
    if source and source not in _GOOD_CLOCKS:
        return Check(
            "clock", "note", found, "a slow clock source: boot with clocksource=tsc if it is stable"
        )
    return Check("clock", "good", found)


def _timer() -> Check:
    late = []
    for _ in range(_SLEEPS):
        due = time.perf_counter() + 1e-3
        time.sleep(1e-3)
        late.append((time.perf_counter() - due) * 1e6)
    middle, worst = statistics.median(late), sorted(late)[int(0.99 * len(late))]
    found = f"after 1 ms of sleep {middle:.0f} µs late, in 1 of 100 cases {worst:.0f} µs or more"
    if worst > _LATE_US:
        return Check("timer", "note", found, "a loop of 1 kHz needs a quieter machine, or cores of its own")
    return Check("timer", "good", found)


def _idle_cores() -> Check:
    states = sorted(Path("/sys/devices/system/cpu/cpu0/cpuidle").glob("state*/name"))
    names = ", ".join(path.read_text(encoding="ascii").strip() for path in states)
    governor = ""
    with suppress(OSError):
        path = Path("/sys/devices/system/cpu/cpu0/cpufreq/scaling_governor")
        governor = f"; frequencies: {path.read_text(encoding='ascii').strip()}"
    found = f"sleep states: {names or 'not told, as in most virtual machines'}{governor}"
    if not _LATENCY.exists():
        return Check("idle cores", "good", f"{found}; --no-halt is not possible: there is no {_LATENCY}")
    if not os.access(_LATENCY, os.R_OK | os.W_OK):
        return Check("idle cores", "note", found, f"--no-halt needs the right to write {_LATENCY}")
    return Check("idle cores", "good", f"{found}; --no-halt is possible")


def _open_files() -> Check:
    from taxel_server.processor import most_open_files

    most = most_open_files()
    found = f"a server may open {most}"
    if most < _FEW_FILES:
        return Check("files", "note", found, "each client takes two: ulimit -n 4096, or LimitNOFILE=")
    return Check("files", "good", found)


def _lane_folder() -> Check:
    from taxel_server.transports.lane_socket import automatic_address

    try:
        address = automatic_address((f"tcp/127.0.0.1:{PORT}",))
    except TaxelError as error:
        return Check("lane", "note", str(error), "set XDG_RUNTIME_DIR, or --lane unix:PATH")
    return Check("lane", "good", f"{address.rpartition('/')[0]} can be used")


def _shared_memory() -> Check:
    if not _SHARED.is_dir():
        return Check("shared memory", "good", f"there is no {_SHARED}; --shared-memory is not possible")
    space = shutil.disk_usage(_SHARED)
    found = f"{_SHARED}: {space.free // 2**20} of {space.total // 2**20} MiB free"
    with suppress(OSError), tempfile.TemporaryFile(dir=_SHARED):
        if space.free >= _LITTLE_SHARED:
            return Check("shared memory", "good", found)
    return Check("shared memory", "note", found, "--shared-memory needs more: docker run --shm-size=256m")


def _port(port: int) -> Check:
    subject = f"port {port}"
    found = listeners_on(port)
    if found is None:
        return Check(subject, "note", "this system does not tell who listens")
    if not found:
        return Check(subject, "good", "free")
    who = ", ".join(found)
    remedy = "choose another with --listen tcp/127.0.0.1:PORT"
    if any("rmw_zenohd" in each or "zenohd" in each for each in found):
        return Check(subject, "bad", f"taken by {who}: the router of zenoh or ROS 2", remedy)
    if any("taxel" in each for each in found):
        return Check(subject, "good", f"a Taxel server listens: {who}")
    return Check(subject, "bad", f"taken by {who}; ROS 2's router listens there, too", remedy)
