"""Optional packages: whether they are installed, and which extra brings them."""

import sys
from importlib.util import find_spec
from typing import Final

from taxel.errors import MissingDependency

SERVING: Final = ("msgspec", "numba", "onnx", "onnxruntime", "prometheus_client", "pydantic_settings")
"""The packages of the extra `server`: for predictions in this process, and for a server."""


def require(purpose: str, extra: str, *packages: str) -> None:
    """Check that packages are installed, without importing them.

    Args:
        purpose: what needs them.
        extra: the extra of Taxel that installs them.
        packages: their import names.

    Raises:
        MissingDependency: a package is missing; the text names it.
    """
    missing = [name for name in packages if not _installed(name)]
    if missing:
        raise MissingDependency(purpose, ", ".join(missing), extra)


def _installed(name: str) -> bool:
    if name in sys.modules:
        return sys.modules[name] is not None
    try:
        return find_spec(name) is not None
    except ModuleNotFoundError:
        # Of `google.protobuf` even `google` is missing.
        return False
