"""Where the server's options come from: command line, environment, `taxel.toml`, defaults."""

from pathlib import Path
from tomllib import TOMLDecodeError
from typing import Any, Final

from pydantic import ValidationError
from pydantic_settings import (
    BaseSettings,
    PydanticBaseSettingsSource,
    SettingsConfigDict,
    TomlConfigSettingsSource,
)
from typing_extensions import override

from taxel.artifacts import describe
from taxel.errors import SettingsError
from taxel_server.options import ServerOptions

FILE: Final = Path("taxel.toml")
"""Settings file, in the working directory."""

PREFIX: Final = "TAXEL_"
"""Environment variables: `TAXEL_MAX_BATCH_ROWS` and so on."""


class ServerSettings(ServerOptions, BaseSettings):
    """The options, read from every source. A source that is earlier in the module's first line wins."""

    model_config = SettingsConfigDict(
        env_prefix=PREFIX, enable_decoding=False, toml_file=FILE, extra="forbid", frozen=True
    )

    client: Any = None
    """The file's table of that name is for clients that start in the same folder."""

    @override
    @classmethod
    def settings_customise_sources(
        cls,
        settings_cls: type[BaseSettings],
        init_settings: PydanticBaseSettingsSource,
        env_settings: PydanticBaseSettingsSource,
        dotenv_settings: PydanticBaseSettingsSource,
        file_secret_settings: PydanticBaseSettingsSource,
    ) -> tuple[PydanticBaseSettingsSource, ...]:
        return init_settings, env_settings, TomlConfigSettingsSource(settings_cls)


def read_settings(given: dict[str, Any]) -> ServerSettings:
    """The server's settings; `given` holds the options of the command line.

    Raises:
        SettingsError: a value is wrong, missing or unknown; the text names it.
    """
    try:
        return ServerSettings(**given)
    except ValidationError as error:
        raise SettingsError(f"server settings: {describe(error)}") from None
    except TOMLDecodeError as error:
        raise SettingsError(f"{FILE}: {error}") from None
