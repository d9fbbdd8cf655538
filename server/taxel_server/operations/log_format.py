"""How a server's log looks: a line of text, or a line of JSON, for each record, with its fields."""

import json
import logging
import sys
import time
from typing import Any, Final, Literal

from typing_extensions import override

LogFormat = Literal["text", "json"]

_LONGEST: Final = 400
"""Characters of one field or message. What clients send must not fill the disk."""


def set_up_log(level: str, form: LogFormat) -> None:
    """Send all records from a level on to stderr."""
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(_JsonFormatter() if form == "json" else _TextFormatter())
    logging.basicConfig(level=level.upper(), handlers=[handler])


def _fields(record: logging.LogRecord) -> dict[str, Any]:
    fields: dict[str, Any] = getattr(record, "fields", {})
    return {name: _short(value) if isinstance(value, str) else value for name, value in fields.items()}


def _short(text: str) -> str:
    return text if len(text) <= _LONGEST else text[: _LONGEST - 1] + "…"


class _TextFormatter(logging.Formatter):
    """`time LEVEL logger: message name=value …`; a client cannot begin a line of its own."""

    def __init__(self) -> None:
        super().__init__("%(asctime)s %(levelname)s %(name)s: %(message)s")

    @override
    def formatMessage(self, record: logging.LogRecord) -> str:
        fields = _fields(record)
        if not fields:
            return super().formatMessage(record)
        record.message = _short(record.message)
        told = "".join(f" {name}={json.dumps(value, ensure_ascii=False)}" for name, value in fields.items())
        line = super().formatMessage(record) + told
        return "".join(char if char.isprintable() else repr(char)[1:-1] for char in line)


class _JsonFormatter(logging.Formatter):
    """One object for each record: `time`, `level`, `logger`, `message`, its fields, and `exception`."""

    @override
    def format(self, record: logging.LogRecord) -> str:
        told: dict[str, Any] = {
            "time": time.strftime("%Y-%m-%dT%H:%M:%S", time.gmtime(record.created))
            + f".{int(record.msecs):03d}Z",
            "level": record.levelname.lower(),
            "logger": record.name,
            "message": _short(record.getMessage()),
            **_fields(record),
        }
        if record.exc_info:
            told["exception"] = self.formatException(record.exc_info)
        return json.dumps(told)
