"""Who gets in over zenoh, and what they may do there: settings of the server's own session.

zenoh checks each message where it comes in and where it leaves, and drops what no rule allows. So a client
can neither declare keys, nor publish, nor ask beyond its rights, whether on a network or on this machine.
"""

import logging
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from taxel.endpoints import host_and_port_of, is_loopback
from taxel.errors import SettingsError
from taxel.protocol import REPLICAS
from taxel_server.options import RIGHTS, ServerOptions

_LOG: Final = logging.getLogger(__name__)

_KEYS: Final[Mapping[str, tuple[str, ...]]] = {
    "metadata": ("", "/*", "/v2/*", "/v2/health/*", "/v2/repository/*", "/v2/models/**"),
    "infer": ("/v2/models/*/infer", "/v2/models/*/versions/*/infer", "/v2/cancel"),
    "administration": ("/v2/repository/models/**",),
}
"""What each right opens, behind the prefix. Other keys are closed, so a new one has to be opened here."""

_LOOPBACK: Final = ("lo", "lo0")
"""The loopback interface on Linux, and on macOS and BSD."""

_EVERYBODY: Final = ("metadata", "infer")


def security_settings(options: ServerOptions) -> dict[str, Any]:
    """zenoh's settings that keep out who does not belong.

    Raises:
        SettingsError: a file that the options name is not there, or is damaged.
    """
    settings: dict[str, Any] = {"access_control": _access_control(options)}
    if options.users is None and options.tls_client_ca is None:
        for endpoint in options.listen:
            if not _is_loopback(endpoint):
                _LOG.warning("anybody who reaches %s may ask: see docs/security.md", endpoint)
    if options.users is not None:
        users = read_users(options.users)
        if unknown := sorted(options.rights().keys() - users):
            raise SettingsError(f"allow: {', '.join(unknown)}: expected users of {options.users}")
        settings["transport/auth/usrpwd/dictionary_file"] = str(options.users)
    if options.tls_certificate is not None:
        settings["transport/link/tls"] = {
            "listen_certificate": _readable("tls_certificate", options.tls_certificate),
            "listen_private_key": _readable("tls_key", options.tls_key),
            "enable_mtls": options.tls_client_ca is not None,
            "close_link_on_expiration": True,
        }
        if options.tls_client_ca is not None:
            authority = _readable("tls_client_ca", options.tls_client_ca)
            settings["transport/link/tls"]["root_ca_certificate"] = authority
    return settings


def read_users(path: Path) -> set[str]:
    """The names in a file of users; zenoh itself reads the passwords.

    Raises:
        SettingsError: it cannot be read, or a line is not USER:PASSWORD; the text tells no password.
    """
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise SettingsError(f"users: {path}: {error}") from None
    names: set[str] = set()
    for number, line in enumerate(lines, 1):
        name, _, password = line.partition(":")
        if not (name and password) or line != line.strip():
            raise SettingsError(
                f"users: {path}, line {number}: expected USER:PASSWORD without spaces around"
            )
        if name in names:
            raise SettingsError(f"users: {path}, line {number}: {name!r} has a line already")
        names.add(name)
    if not names:
        raise SettingsError(f"users: {path}: expected a line USER:PASSWORD for each user")
    return names


def _is_loopback(endpoint: str) -> bool:
    """Whether only this machine reaches an endpoint, as far as its text tells."""
    address = host_and_port_of(endpoint)
    if address is None:
        return endpoint.startswith("unixsock-stream/")
    return is_loopback(address[0])


def _readable(option: str, path: Path | None) -> str:
    try:
        assert path is not None
        with path.open("rb"):
            return str(path)
    except OSError as error:
        raise SettingsError(f"{option}: {error}") from None


def _access_control(options: ServerOptions) -> dict[str, Any]:
    """zenoh's access control. A denial outweighs all that is allowed."""
    keys = {right: _below(options.prefix, paths) for right, paths in _KEYS.items()}
    rules = [_rule(f"may {right}", "allow", keys[right]) for right in RIGHTS]
    rules.append(_rule("no infer", "deny", keys["infer"]))
    prefixes = [f"{options.prefix}/**", f"{options.prefix}/{REPLICAS}/**"]
    replicas = [f"{options.prefix}/{REPLICAS}/*"]
    rules += [
        _rule("answers", "allow", prefixes, ("reply", "declare_queryable"), "egress"),
        _rule("tokens", "allow", replicas, ("liveliness_token",), "egress"),
        _rule("watch", "allow", replicas, ("liveliness_query", "declare_liveliness_subscriber")),
    ]
    common = ["answers", "tokens", "watch"]
    named = options.rights()
    subjects: list[dict[str, Any]] = [{"id": "everybody"}]
    everybody = (*_EVERYBODY, "administration") if options.admin == "any" else _EVERYBODY
    policies = [{"subjects": ["everybody"], "rules": [*common, *(() if named else _may(everybody))]}]
    if not named and options.admin != "any":  # off: the server itself says so
        subjects += [
            {"id": "loopback", "interfaces": list(_LOOPBACK)},
            {"id": "socket", "link_protocols": ["unixsock-stream"]},
        ]
        policies.append({"subjects": ["loopback", "socket"], "rules": _may(("administration",))})
    proof = "usernames" if options.users is not None else "cert_common_names"
    for name, rights in named.items():
        subjects.append({"id": f"name {name}", proof: [name]})
        denied = [] if "infer" in rights else ["no infer"]
        policies.append({"subjects": [f"name {name}"], "rules": [*_may(rights), *denied]})
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": subjects,
        "policies": policies,
    }


def _may(rights: tuple[str, ...]) -> list[str]:
    return [f"may {right}" for right in rights]


def _below(prefix: str, paths: tuple[str, ...]) -> list[str]:
    """Keys of the server, and of the same server as a replica."""
    return [f"{top}{path}" for top in (prefix, f"{prefix}/{REPLICAS}/*") for path in paths]


def _rule(
    name: str,
    permission: str,
    keys: list[str],
    messages: tuple[str, ...] = ("query",),
    flow: str = "ingress",
) -> dict[str, Any]:
    return {
        "id": name,
        "permission": permission,
        "messages": list(messages),
        "flows": [flow],
        "key_exprs": keys,
    }
