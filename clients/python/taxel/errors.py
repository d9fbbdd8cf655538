"""Every error that Taxel raises on purpose, in one tree.

    TaxelError
    ├── RequestError            an inference request was not answered with a prediction
    │   ├── InvalidArgument     the request itself is wrong: shape, datatype, NaN, bytes
    │   ├── NotFound            no such model, version or key
    │   ├── ResourceExhausted   the server's queue is full, or the request is too large
    │   ├── DeadlineExceeded    the answer would have come too late
    │   ├── Cancelled           its client has given it up, or has gone: nobody waits for it
    │   ├── PermissionDenied    a server is there, but does not let this client ask
    │   ├── Unavailable         nobody answers, or the server is stopping
    │   │   └── ServerLost      the connection was lost before the answer was there
    │   └── Internal            a fault of the server
    ├── ArtifactError           a model on disk is damaged, inconsistent or unsupported
    ├── RecordingError          a recording is damaged; names the file, line and expectation
    ├── SettingsError           an option or a settings file is wrong
    └── MissingDependency       an optional package is needed; names the extra to install

Where they come from: a `RequestError` crosses the wire as its `code` and text and is raised
again, as the same class, by the client. The others never cross it: they stop a command before
anything has been overwritten.

An `InputWarning` is no error: an input is well formed and probably wrong all the same.
"""

from typing import ClassVar, Final, Literal

Code = Literal[
    "INVALID_ARGUMENT",
    "NOT_FOUND",
    "RESOURCE_EXHAUSTED",
    "DEADLINE_EXCEEDED",
    "CANCELLED",
    "PERMISSION_DENIED",
    "UNAVAILABLE",
    "INTERNAL",
]


class TaxelError(Exception):
    """Base of every error that Taxel raises on purpose."""


class RequestError(TaxelError):
    """A request was refused or could not be answered; `code` is what the wire carries."""

    code: ClassVar[Code] = "INTERNAL"


class InvalidArgument(RequestError):
    """The request is wrong, and would be wrong again: its text names the field.

    Cure: mend the field; the text says what was expected of it. Asking again does not help.
    """

    code = "INVALID_ARGUMENT"


class NotFound(RequestError):
    """The model, version or key does not exist.

    Cure: `taxel models` lists what there is. A name is often misspelt, or its version was unloaded.
    """

    code = "NOT_FOUND"


class ResourceExhausted(RequestError):
    """The queue is full, or the request exceeds a limit.

    Cure: ask again later if the queue is full; split the request if it exceeds a limit.

    Args:
        text: what is exhausted.
        open_requests: where the queue is full, how many other requests of this client the server holds.
    """

    code = "RESOURCE_EXHAUSTED"

    def __init__(self, text: str, open_requests: int | None = None) -> None:
        super().__init__(text)
        self.open_requests = open_requests


class DeadlineExceeded(RequestError):
    """No answer within the time that the caller allowed.

    Cure: allow more time, or ask for fewer windows at once; `taxel top` shows how busy the server is.
    """

    code = "DEADLINE_EXCEEDED"


class Cancelled(RequestError):
    """The client has given the request up, or has gone; so the server dropped it.

    Cure: none is needed: nobody waits for the answer. Ask again if you still want it.
    """

    code = "CANCELLED"


class PermissionDenied(RequestError):
    """A server is there, but does not let this client in or ask; or the client does not trust it.

    Cure: give the certificates, or the name and password, that the server wants; see docs/security.md.
    """

    code = "PERMISSION_DENIED"


class Unavailable(RequestError):
    """No server answers at this endpoint, or it is stopping.

    Cure: start one, or mend the endpoint: `taxel serve` prints it as `listening on`.
    """

    code = "UNAVAILABLE"


class ServerLost(Unavailable):
    """The connection to the server was lost before the answer was there.

    Cure: ask again: the next call connects by itself.
    """


class Internal(RequestError):
    """The server failed.

    Cure: read its log, and report it as a fault of Taxel. Asking again may help.
    """

    code = "INTERNAL"


class ArtifactError(TaxelError):
    """A model on disk is damaged, inconsistent or not supported.

    Cure: export it again with `taxel export`, or copy it whole. A newer Taxel wrote it? Update this one.
    """


class RecordingError(TaxelError):
    """A recording is damaged: the text names the file, the line and what was expected.

    Cure: mend or drop that line; `taxel recording FILE` looks at the whole file.
    """


class SettingsError(TaxelError):
    """An option, environment variable or settings file is wrong.

    Cure: the text names it and what was expected; `taxel COMMAND --help` lists all options.
    """


class MissingDependency(TaxelError):
    """An optional package is not installed.

    Cure: run the command that the text ends with, as `pip install 'taxel[watch]'`.

    Args:
        purpose: what needs it.
        package: the missing package, or several with commas between them.
        extra: the extra of Taxel that installs it.
    """

    def __init__(self, purpose: str, package: str, extra: str) -> None:
        super().__init__(f"{purpose} needs {package}: pip install 'taxel[{extra}]'")


class InputWarning(UserWarning):
    """An input looks wrong: its unit, sign, frame or rate. The text says what was seen and expected.

    Cure: convert the input. If it is right as it is, silence this warning as Python's others.
    """


_BY_CODE: Final[dict[str, type[RequestError]]] = {
    error.code: error
    for error in (
        InvalidArgument,
        NotFound,
        ResourceExhausted,
        DeadlineExceeded,
        Cancelled,
        PermissionDenied,
        Unavailable,
        Internal,
    )
}


def from_code(code: str, text: str) -> RequestError:
    """The error of a wire `code`. An unknown code becomes `Internal`, and the text says so."""
    error = _BY_CODE.get(code)
    return error(text) if error else Internal(f"{text} (unknown error code {code!r})")
