"""Administration: an operator loads and unloads versions of a running server.

The path is `v2/repository/models/NAME[/versions/VERSION]/load`, or `…/unload`, as the Open Inference
Protocol's extension for repositories has it.
"""

from typing import Any, Final, Literal, NamedTuple, Self

from taxel.artifacts import is_name, is_version
from taxel.errors import Internal, InvalidArgument
from taxel.protocol import packb, unpackb
from taxel.remote import RemoteSource

Action = Literal["load", "unload"]

_ROOT: Final = "v2/repository/models"


class Order(NamedTuple):
    """What an operator asks for.

    Attributes:
        action: what to do.
        name: the model.
        version: if None, the newest in the repository is loaded, or the one that answers is unloaded.
        shadow: whether a version that is loaded answers only copies of requests, to be compared.
    """

    action: Action
    name: str
    version: str | None = None
    shadow: bool = False

    @property
    def path(self) -> str:
        """The key without the server's prefix."""
        where = f"/versions/{self.version}" if self.version else ""
        return f"{_ROOT}/{self.name}{where}/{self.action}"

    def payload(self) -> bytes:
        """The content of the query."""
        return packb({"parameters": {"shadow": True}} if self.shadow else {})

    @classmethod
    def read(cls, path: str, payload: bytes) -> Self | None:
        """The order at a path; None if it is no path of orders.

        Raises:
            InvalidArgument: the payload is malformed.
        """
        match path.removeprefix(f"{_ROOT}/").split("/"):
            case [name, "versions", version, ("load" | "unload") as action] if is_version(version):
                found = cls(action, name, version)
            case [name, ("load" | "unload") as action]:
                found = cls(action, name)
            case _:
                return None
        if not path.startswith(f"{_ROOT}/") or not is_name(name):
            return None
        content = unpackb(payload) if payload else {}
        parameters = content.get("parameters", {}) if isinstance(content, dict) else None
        shadow = parameters.get("shadow", False) if isinstance(parameters, dict) else None
        if not isinstance(shadow, bool) or (shadow and action == "unload"):
            raise InvalidArgument(
                f"payload {content!r}: expected a map, with parameters.shadow true to load a shadow"
            )
        return found._replace(shadow=shadow)


def pack_version(name: str, version: str) -> bytes:
    """Encode the answer to an order: the version that was loaded or unloaded."""
    return packb({"name": name, "version": version})


def give_order(source: RemoteSource, order: Order, timeout: float) -> str:
    """Ask a server to load or unload a version; returns which one it was.

    Args:
        source: a connection to the server.
        order: what to do.
        timeout: seconds to wait until it is done.

    Raises:
        PermissionDenied: the server takes no orders from here.
        NotFound: there is no such version.
        Unavailable: the version cannot be served; the text says why.
        RequestError: there is no answer.
    """
    answer: Any = unpackb(source.get(f"{source.prefix}/{order.path}", order.payload(), timeout))
    try:
        return str(answer["version"])
    except (KeyError, TypeError) as error:
        raise Internal(f"{source.endpoint}: the answer is malformed: {error!r}") from None
