"""A new environment: `pip install 'taxel[…]'` installs the wheel of this checkout, without an index."""

import os
import subprocess
import sys
from pathlib import Path
from typing import Final

from .blocks import ROOT

_LEFT_OUT: Final = ("taxel", "_taxel", "pip", "__")
"""How the names begin of what a new environment shall not see: Taxel itself, and the tests' own pip."""


def new_environment(folder: Path) -> dict[str, str]:
    """The variables of a shell in a new environment, which has pip and no Taxel.

    All other packages are those that the tests have. pip finds them installed, and compares their versions
    with what the wheel and its extras ask for.
    """
    wheels, packages, environment = (folder / name for name in ("wheels", "packages", "environment"))
    for command in (
        ["build", "--wheel", "--no-isolation", "--outdir", str(wheels), str(ROOT)],
        ["venv", str(environment)],
    ):
        done = subprocess.run([sys.executable, "-m", *command], capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout + done.stderr
    packages.mkdir()
    for place in (Path(path) for path in sys.path if Path(path).name in ("site-packages", "dist-packages")):
        for package in place.iterdir() if place.is_dir() else ():
            link = packages / package.name
            if package.name.startswith(_LEFT_OUT) or package.suffix == ".pth" or link.exists():
                continue
            link.symlink_to(package)
    return {
        "PATH": f"{environment / 'bin'}{os.pathsep}{os.environ['PATH']}",
        "PYTHONPATH": str(packages),
        # Nobody's settings: no index, and no other folder of wheels.
        "PIP_CONFIG_FILE": os.devnull,
        "PIP_NO_INDEX": "1",
        "PIP_FIND_LINKS": str(wheels),
        "PIP_DISABLE_PIP_VERSION_CHECK": "1",
        # What the server compiles there is of no use to anybody else.
        "XDG_CACHE_HOME": str(folder / "cache"),
    }
