"""Runs tests in an emulated environment of ARM with 64 bits: a Raspberry Pi 4's processor, on any Debian.

    python tests/arm/emulate.py [pytest's arguments]

The environment is Debian's own Python for arm64 and wheels from the package index, of the versions in
constraints.txt, in build/arm. Only what is missing is made. It needs Debian's apt-get and qemu-user-static,
but neither root nor a kernel that starts programs of another processor. Run it with the Python of an
environment that has everything (`make arm` does).
"""

import json
import os
import platform
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Final

CHECKOUT: Final = Path(__file__).resolve().parents[2]
FOLDER: Final = CHECKOUT / "build" / "arm"
ROOT: Final = FOLDER / "root"
ENVIRONMENT: Final = FOLDER / "environment"
PYTHON: Final = ENVIRONMENT / "bin" / "python"

CPU: Final = "cortex-a72"
CPUINFO: Final = """\
processor\t: {number}
Features\t: fp asimd evtstrm aes pmull sha1 sha2 crc32 cpuid
CPU implementer\t: 0x41
CPU architecture: 8
CPU variant\t: 0x0
CPU part\t: 0xd08
CPU revision\t: 3

"""
"""What Linux says of the processor; LLVM and ONNX Runtime read it, and older QEMUs show the host's."""

SYSTEM: Final = ("python3", "libstdc++6")
LIBRARIES: Final = ("xgboost-cpu", "pytest", "hypothesis", "scipy", "matplotlib")
"""What the tests need beyond what serving needs. PyTorch's wheels are too large."""

TREES: Final = "tests/server/trees"
NETWORKS: Final = "tests/server/networks"
TESTS: Final = (
    *(f"{TREES}/test_lookups.py", f"{TREES}/test_few_rows_kernels.py", f"{TREES}/test_evaluators.py"),
    *(f"{TREES}/test_exactness.py", f"{TREES}/test_ranks.py", f"{TREES}/test_runtime.py"),
    *(f"{NETWORKS}/test_activations.py", f"{NETWORKS}/test_panels.py"),
)


def main(arguments: list[str]) -> int:
    """Makes the environment, runs the tests and compares the shipped models' predictions."""
    emulator = next(filter(None, map(shutil.which, ("qemu-aarch64-static", "qemu-aarch64"))), None)
    missing = [name for name in ("apt-get", "dpkg-deb") if not shutil.which(name)]
    if emulator is None or missing:
        wanted = ", ".join([*missing, *([] if emulator else ["qemu-aarch64-static"])])
        print(f"{wanted}: not found. On Debian: apt install qemu-user-static", file=sys.stderr)
        return 1
    if not (ROOT / "proc").is_dir():
        unpack_system()
    version = next(ROOT.glob("usr/bin/python3.*[0-9]")).name
    make_environment(emulator, version)
    install(version)
    run = [("-m", "pytest", "-p", "no:cacheprovider", "--no-header", "-v", *(arguments or TESTS))]
    if not arguments:
        expected, script = str(FOLDER / "x86-64.npz"), str(CHECKOUT / "tests/arm/predictions.py")
        subprocess.run([sys.executable, script, "write", expected], check=True)
        run.insert(0, (script, "compare", expected))
    print_versions(emulator)
    environment = os.environ | {"NUMBA_CACHE_DIR": str(FOLDER / "numba")}
    return max(
        subprocess.run([PYTHON, *command], cwd=CHECKOUT, env=environment).returncode for command in run
    )


def unpack_system() -> None:
    """Debian's packages for arm64, from where this Debian gets its own, unpacked without installing."""
    apt, archives = FOLDER / "apt", FOLDER / "apt" / "cache" / "archives"
    for folder in (apt / "lists" / "partial", archives / "partial"):
        folder.mkdir(parents=True, exist_ok=True)
    (apt / "status").touch()
    settings = apt / "apt.conf"
    settings.write_text(
        f"""\
APT::Architecture "arm64";
APT::Architectures {{ "arm64"; }};
APT::Install-Recommends "false";
Dir::State "{apt}";
Dir::State::status "{apt}/status";
Dir::Cache "{apt}/cache";
"""
    )
    environment = os.environ | {"APT_CONFIG": str(settings)}
    for command in (["update"], ["install", "--download-only", "--yes", *SYSTEM]):
        subprocess.run(["apt-get", "-qq", *command], env=environment, check=True)
    for package in sorted(archives.glob("*.deb")):
        subprocess.run(["dpkg-deb", "--extract", package, ROOT], check=True)
    (ROOT / "proc").mkdir()
    (ROOT / "proc" / "cpuinfo").write_text("".join(CPUINFO.format(number=number) for number in (0, 1)))


def make_environment(emulator: str, version: str) -> None:
    """A virtual environment whose Python is a script that starts the emulator: so it can start itself."""
    PYTHON.parent.mkdir(parents=True, exist_ok=True)
    binary = ROOT / "usr" / "bin" / version
    PYTHON.write_text(f'#!/bin/sh\nexec {emulator} -cpu {CPU} -L {ROOT} -0 {PYTHON} {binary} "$@"\n')
    PYTHON.chmod(0o755)
    (ENVIRONMENT / "pyvenv.cfg").write_text(f"home = {binary.parent}\n")


def install(version: str) -> None:
    """Wheels for the environment, and this checkout in its place."""
    packages = ENVIRONMENT / "lib" / version / "site-packages"
    project = tomllib.loads((CHECKOUT / "pyproject.toml").read_text())["project"]
    wanted = [*project["dependencies"], *project["optional-dependencies"]["server"], *LIBRARIES]
    constraints = CHECKOUT / "constraints.txt"
    made_of = json.dumps([wanted, constraints.read_text()])
    stamp = ENVIRONMENT / "made_of.json"
    if stamp.exists() and stamp.read_text() == made_of:
        return
    shutil.rmtree(packages, ignore_errors=True)
    systems = [f"manylinux_2_{number}_aarch64" for number in range(36, 16, -1)] + ["manylinux2014_aarch64"]
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "install", "-q", "--target"]
    given = ["-c", str(constraints), "--only-binary=:all:", "--python-version", version[6:]]
    given += [argument for system in systems for argument in ("--platform", system)]
    subprocess.run([*pip, str(packages), *given, *wanted], check=True)
    itself = ["--no-deps", "--no-build-isolation", "-e", str(CHECKOUT)]
    subprocess.run([*pip, str(packages), *itself], check=True)
    stamp.write_text(made_of)


def print_versions(emulator: str) -> None:
    """What runs what."""
    told = subprocess.run([emulator, "--version"], capture_output=True, text=True, check=True).stdout
    print(f"{told.splitlines()[0]}, -cpu {CPU}, on {platform.machine()}", flush=True)
    code = (
        "import platform, sys, llvmlite.binding as llvm; from importlib.metadata import version;"
        "from taxel_server.runtimes.compiled.processor import instruction_set;"
        "print(platform.machine(), 'Python', platform.python_version());"
        "print('LLVM', llvm.llvm_version_info, llvm.get_host_cpu_name(),"
        " llvm.get_host_cpu_features().flatten());"
        "print(*(f'{name} {version(name)}' for name in ('numpy', 'numba', 'xgboost-cpu', 'onnxruntime')));"
        "print('instruction set', instruction_set(), flush=True)"
    )
    subprocess.run([PYTHON, "-c", code], check=True)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
