"""Who a client is, and whom it trusts: for servers that ask for a user, or that have a certificate."""

import os
import tomllib
from pathlib import Path
from typing import Any, Final, Self

from pydantic import BaseModel, ConfigDict, SecretStr, ValidationError, model_validator

from taxel.artifacts import describe
from taxel.errors import SettingsError

FILE: Final = Path("taxel.toml")
"""Settings file, in the working directory."""

TABLE: Final = "client"
"""Its table for clients."""

VARIABLE: Final = "TAXEL_CLIENT_"
"""Environment variables: `TAXEL_CLIENT_USER` and so on. They outweigh the file."""


class Credentials(BaseModel):
    """What a client shows to a server, and what it asks of the server.

    Attributes:
        user: its name in the server's file of users.
        password: that user's password. It is not sent: the client proves that it knows it.
        ca: PEM file of the authority that must have signed the server's certificate; if none, the
            well-known authorities are trusted.
        certificate: PEM file of the client's own certificate, for a server that asks for one.
        key: PEM file of that certificate's private key.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    user: str | None = None
    password: SecretStr | None = None
    ca: Path | None = None
    certificate: Path | None = None
    key: Path | None = None

    @model_validator(mode="after")
    def _complete(self) -> Self:
        if (self.user is None) != (self.password is None):
            raise ValueError("user, password: expected both or neither")
        if (self.certificate is None) != (self.key is None):
            raise ValueError("certificate, key: expected both or neither")
        for file in (self.ca, self.certificate, self.key):
            if file is not None and not file.is_file():
                raise ValueError(f"{file}: expected a PEM file")
        return self

    @classmethod
    def from_surroundings(cls) -> Self:
        """Those of the environment and of `taxel.toml`.

        Raises:
            SettingsError: one is wrong or unknown; the text names it, and tells no password.
        """
        given = _from_file()
        for name in cls.model_fields:
            if (value := os.environ.get(f"{VARIABLE}{name.upper()}")) is not None:
                given[name] = value
        try:
            return cls(**given)
        except ValidationError as error:
            raise SettingsError(
                f"{FILE}, table [{TABLE}], or a variable {VARIABLE}…: {describe(error)}"
            ) from None

    def zenoh_settings(self) -> dict[str, Any]:
        """Settings of a session that has these credentials."""
        settings: dict[str, Any] = {}
        if self.user is not None and self.password is not None:
            password = self.password.get_secret_value()
            settings["transport/auth/usrpwd"] = {"user": self.user, "password": password}
        tls: dict[str, Any] = {}
        if self.ca is not None:
            tls["root_ca_certificate"] = str(self.ca)
        if self.certificate is not None:
            tls["enable_mtls"] = True
            tls["connect_certificate"] = str(self.certificate)
            tls["connect_private_key"] = str(self.key)
        return settings | ({"transport/link/tls": tls} if tls else {})


def _from_file() -> dict[str, Any]:
    try:
        table = tomllib.loads(FILE.read_text(encoding="utf-8")).get(TABLE, {})
    except FileNotFoundError:
        return {}
    except (OSError, ValueError) as error:
        raise SettingsError(f"{FILE}: {error}") from None
    if not isinstance(table, dict):
        raise SettingsError(f"{FILE}: expected a table [{TABLE}]")
    return dict(table)
