"""Peers: what they are, what they are given, and how their packages are imported."""

import site
import subprocess
import sysconfig
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final, Generic, TypeVar

from taxel.artifacts import Artifact
from taxel.errors import TaxelError, Unavailable
from taxel_bench.engines import Engine
from taxel_bench.environments import environment, own_versions

if TYPE_CHECKING:
    import onnx
    import xgboost

    from taxel_models.families.networks.network import NetworkModel

ENGINES: Final = "engines"
"""The folder of the peers' environments, below the cache folder."""

_SHARED: Final = ("numpy", "scipy", "scikit-learn", "onnxruntime")
"""Packages that a peer shares with Taxel: both use the same versions."""


@dataclass(frozen=True)
class ForestModel:
    """The forest that peers are given.

    Attributes:
        boosters: a booster a channel, which computes z-scores; together they are the artifact's model.
        install: whether a peer may take minutes to get ready.
    """

    artifact: Artifact
    boosters: "tuple[xgboost.Booster, ...]"
    install: bool


@dataclass(frozen=True)
class GraphModel:
    """The ONNX network that peers are given.

    Attributes:
        graph: raw windows in, counts out.
        network: the torch network behind it; None where there is none.
        same_weights: whether `network` has the weights of `graph`.
    """

    artifact: Artifact
    graph: "onnx.ModelProto"
    network: "NetworkModel | None"
    same_weights: bool


Model = TypeVar("Model", ForestModel, GraphModel)


@dataclass(frozen=True)
class Peer(Generic[Model]):
    """A library that a user may pick instead of Taxel's runtime.

    Attributes:
        name: on the command line, and `engine` in the results.
        engine: makes its engine from a model. It raises `Unavailable` where it cannot evaluate it.
        packages: with exact versions, in an environment of its own; none where Taxel's environment
            has them.
        module: that has to be importable there.
    """

    name: str
    engine: Callable[[Model], Engine]
    packages: tuple[str, ...] = ()
    module: str = ""

    def get_ready(self, *, install: bool) -> None:
        """Make the peer's packages importable here.

        Raises:
            Unavailable: they are not installed and may not be, or they do not work.
        """
        if not self.packages:
            return
        requirements = [*self.packages, *own_versions(*_SHARED)]
        interpreter = environment(f"{ENGINES}/{self.name}", requirements, install=install)
        # A package that would end its process ends this one, not the benchmark.
        done = subprocess.run(
            [interpreter, "-c", f"import {self.module}"], capture_output=True, text=True, check=False
        )
        if done.returncode:
            last = done.stderr.strip().splitlines()[-1:] or [f"it ended with code {done.returncode}"]
            raise Unavailable(f"{self.module} cannot be imported: {last[0]}")
        # Behind our own packages, so that what both have stays ours.
        site.addsitedir(str(packages_of(interpreter)))


def reason_of(error: Exception) -> str:
    """Why a peer has no part: in our words, or in the first line of its own."""
    if isinstance(error, TaxelError):
        return str(error)
    lines = str(error).strip().splitlines()
    return ": ".join([type(error).__name__, *lines[:1]])


def packages_of(interpreter: Path) -> Path:
    """The folder that an environment's packages are in.

    Raises:
        Unavailable: the environment is of another Python version than this process.
    """
    base = str(interpreter.parents[1])
    folder = Path(sysconfig.get_path("purelib", "venv", {"base": base, "platbase": base}))
    if not folder.is_dir():
        raise Unavailable(f"{base} was made by another Python: remove it, and pass --install")
    return folder
