"""Optional packages: whether they are installed, and which extra brings them."""

import sys
from importlib.util import find_spec
from typing import Final

from taxel.errors import MissingDependency

SERVING: Final = ("msgspec", "numba", "onnx", "onnxruntime", "pydantic_settings")
"""What the extra `server` brings: predictions in this process, and a server."""


def require(purpose: str, extra: str, *packages: str) -> None:
    """Refuse to begin what needs packages that are not installed. Imports none of them.

    Args:
        purpose: what needs them.
        extra: of Taxel, which brings all of them.
        packages: by the names that they are imported by.

    Raises:
        MissingDependency: names those that are missing.
    """
    missing = [name for name in packages if not _installed(name)]
    if missing:
        raise MissingDependency(purpose, ", ".join(missing), extra)


def _installed(name: str) -> bool:
    if name in sys.modules:
        return sys.modules[name] is not None
    return find_spec(name) is not None
