"""The machine that figures were measured on."""

import os
import platform
import subprocess
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Final

import psutil

_PACKAGES: Final = (
    *("taxel", "numpy", "numba", "llvmlite", "onnxruntime", "xgboost", "xgboost-cpu", "scikit-learn"),
    *("torch", "eclipse-zenoh", "treelite", "tl2cgen", "scikit-learn-intelex", "daal", "openvino"),
)
"""Those that are importable: a peer's own environment is, once the peer takes part."""

_VECTOR_FLAGS: Final = (
    *("sse4_1", "ssse3", "avx", "avx2", "fma", "f16c", "avx512f", "avx512bw", "avx512dq", "avx512vl"),
    *("avx512_vbmi", "avx512vbmi", "avx512_vnni", "avx512_bf16", "avx_vnni", "amx_tile", "amx_int8"),
    *("amx_bf16", "asimd", "sve"),
)
"""Instructions that decide which code the runtimes choose, as Linux names them."""

_CHECKOUT: Final = Path(__file__).resolve().parents[2]


def describe_machine() -> dict[str, Any]:
    """The processor, the system, its load, and the versions of what was measured.

    `flags` are the processor's vector instructions and `caches` its caches, both empty where the
    system does not tell; `load` is the mean number of busy or waiting threads over the last minute.
    `commit` is that of the checkout which is measured, null where there is none.
    """
    return {
        "cpu": _cpu_model(),
        "flags": _flags(),
        "cores": _cores(),
        "caches": _caches(),
        "memory_gb": round(psutil.virtual_memory().total / 1e9, 1),
        "load": round(psutil.getloadavg()[0], 2),
        "system": platform.platform(),
        "python": platform.python_version(),
        "versions": {name: found for name in _PACKAGES if (found := _version(name))},
        "commit": commit_of(_CHECKOUT),
    }


def commit_of(checkout: Path) -> dict[str, Any] | None:
    """The short hash of a checkout's commit, and whether tracked files differ from it; None without one."""
    top = _git(checkout, "rev-parse", "--show-toplevel")
    # A package that is installed may lie inside someone else's checkout.
    if top is None or Path(top).resolve() != checkout.resolve():
        return None
    commit = _git(checkout, "describe", "--always", "--dirty", "--exclude=*")
    if commit is None:
        return None
    return {"hash": commit.removesuffix("-dirty"), "dirty": commit.endswith("-dirty")}


def _git(folder: Path, *arguments: str) -> str | None:
    """What git says; None where it fails, or there is no git."""
    try:
        done = subprocess.run(
            ["git", "-C", folder, *arguments], capture_output=True, text=True, check=False
        )
    except OSError:
        return None
    return done.stdout.strip() if done.returncode == 0 else None


def _cores() -> int:
    """Cores that this process may use, which can be fewer than the machine has."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _cpu_model() -> str:
    return _cpuinfo("model name") or platform.processor() or platform.machine()


def _flags() -> list[str]:
    known = set((_cpuinfo("flags") or _cpuinfo("Features")).split())
    return [flag for flag in _VECTOR_FLAGS if flag in known]


def _cpuinfo(field: str) -> str:
    """A field of the first processor; empty where there is none."""
    for line in _text(Path("/proc/cpuinfo")).splitlines():
        name, _, value = line.partition(":")
        if name.strip() == field:
            return value.strip()
    return ""


def _caches() -> dict[str, str]:
    """Sizes of the first core's data caches, such as L2: 1024K."""
    folders = sorted(Path("/sys/devices/system/cpu/cpu0/cache").glob("index*"))
    kinds = [(_text(folder / "type").strip(), folder) for folder in folders]
    return {
        f"L{_text(folder / 'level').strip()}": _text(folder / "size").strip()
        for kind, folder in kinds
        if kind in ("Data", "Unified")
    }


def _text(path: Path) -> str:
    """What the system says there; nothing where it does not."""
    try:
        return path.read_text(encoding="utf-8")
    except OSError:
        return ""


def _version(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None
