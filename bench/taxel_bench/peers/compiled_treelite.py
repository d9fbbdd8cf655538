"""A forest as C code that a C compiler has compiled, kept in the cache folder."""

import hashlib
import json
import os
import shutil
import signal
import subprocess
from pathlib import Path
from typing import Final

from taxel.artifacts import Artifact
from taxel.atomic import whole_folder
from taxel.errors import Unavailable
from taxel_bench.environments import cache_folder, interpreter_of
from taxel_bench.peers.peer import ENGINES

NAME: Final = "treelite-compiled"
PACKAGES: Final = ("tl2cgen==1.0.0", "treelite==4.8.1")

LIMIT_S: Final = 1200.0
"""How long the compiler may take."""

_LIBRARY: Final = "forest.so"
_TOO_LONG: Final = "took-too-long"

_COMPILE: Final = """
import sys, tl2cgen, treelite
forest = treelite.frontend.load_xgboost_model(sys.argv[1], format_choice="inspect")
parts = {"parallel_comp": 32}
tl2cgen.export_lib(forest, toolchain="gcc", libpath=sys.argv[2], params=parts, options=["-O1"])
"""
"""-O1 shortens gcc's work."""


def compiled_library(artifact: Artifact, *, install: bool, limit_s: float = LIMIT_S) -> Path:
    """The compiled forest of an artifact.

    Args:
        install: whether it may be compiled now.
        limit_s: seconds that this may take.

    Raises:
        Unavailable: there is no gcc, it takes too long, or it is not compiled and may not be now.
    """
    made_of = [artifact.manifest.model_file.sha256, _COMPILE, *PACKAGES]
    folder = cache_folder() / "compiled" / hashlib.sha256(json.dumps(made_of).encode()).hexdigest()
    if (folder / _LIBRARY).is_file():
        return folder / _LIBRARY
    if (folder / _TOO_LONG).is_file():
        raise Unavailable((folder / _TOO_LONG).read_text(encoding="utf-8"))
    if shutil.which("gcc") is None:
        raise Unavailable("there is no gcc to compile its C code")
    if not install:
        raise Unavailable("its C code is not compiled yet: pass --install, and it takes some minutes")
    with whole_folder(folder) as making:
        try:
            _compile(artifact.model_path, making / _LIBRARY, limit_s)
        except subprocess.TimeoutExpired:
            reason = (
                f"gcc takes longer than {limit_s:g} s to compile {artifact.manifest.parameters:,} nodes; "
                f"to try again, remove {folder}"
            )
            (making / _TOO_LONG).write_text(reason, encoding="utf-8")
    return compiled_library(artifact, install=False)


def _compile(model: Path, library: Path, limit_s: float) -> None:
    interpreter = interpreter_of(cache_folder() / ENGINES / NAME)
    process = subprocess.Popen(
        [interpreter, "-c", _COMPILE, model, library],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        # A group of its own, so that the compilers that it starts end with it.
        start_new_session=True,
    )
    try:
        _, errors = process.communicate(timeout=limit_s)
    except BaseException:
        os.killpg(process.pid, signal.SIGKILL)
        process.communicate()
        raise
    if process.returncode:
        raise Unavailable(f"its C code cannot be compiled: {errors.strip().splitlines()[-1]}")
