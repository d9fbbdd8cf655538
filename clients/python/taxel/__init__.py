"""Taxel: the signals of a BioTac tactile fingertip, predicted from contacts.

    import taxel

    with taxel.connect("tcp/127.0.0.1:7447") as server:
        predictor = server.predictor()
        channels = predictor.predict(windows)  # (n, f) float32 -> (n, 21) counts

Names load on first use, so that importing the package costs next to nothing.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from taxel.channels import CHANNELS, COUNTS_MAX, ELECTRODES
    from taxel.errors import (
        ArtifactError,
        Cancelled,
        DeadlineExceeded,
        Internal,
        InvalidArgument,
        MissingDependency,
        NotFound,
        PermissionDenied,
        RecordingError,
        RequestError,
        ResourceExhausted,
        ServerLost,
        SettingsError,
        TaxelError,
        Unavailable,
    )
    from taxel.local import load
    from taxel.manifest import Manifest
    from taxel.predictor import ModelInfo, Predictor, PredictorSource, Timing
    from taxel.remote.async_source import connect_async
    from taxel.remote.credentials import Credentials
    from taxel.remote.source import connect
    from taxel.windows import (
        LiveWindow,
        Samples,
        Windows,
        WindowSpec,
        WindowStream,
        build_windows,
    )

_HOMES: Final = {
    "channels": ("CHANNELS", "COUNTS_MAX", "ELECTRODES"),
    "errors": (
        "ArtifactError",
        "Cancelled",
        "DeadlineExceeded",
        "Internal",
        "InvalidArgument",
        "MissingDependency",
        "NotFound",
        "PermissionDenied",
        "RecordingError",
        "RequestError",
        "ResourceExhausted",
        "ServerLost",
        "SettingsError",
        "TaxelError",
        "Unavailable",
    ),
    "local": ("load",),
    "manifest": ("Manifest",),
    "predictor": ("ModelInfo", "Predictor", "PredictorSource", "Timing"),
    "remote.source": ("connect",),
    "remote.credentials": ("Credentials",),
    "remote.async_source": ("connect_async",),
    "windows": (
        "LiveWindow",
        "Samples",
        "WindowSpec",
        "WindowStream",
        "Windows",
        "build_windows",
    ),
}
_HOME_OF: Final = {name: home for home, names in _HOMES.items() for name in names}

__version__: Final = "0.3.0"

__all__ = [
    "CHANNELS",
    "COUNTS_MAX",
    "ELECTRODES",
    "ArtifactError",
    "Cancelled",
    "Credentials",
    "DeadlineExceeded",
    "Internal",
    "InvalidArgument",
    "LiveWindow",
    "Manifest",
    "MissingDependency",
    "ModelInfo",
    "NotFound",
    "PermissionDenied",
    "Predictor",
    "PredictorSource",
    "RecordingError",
    "RequestError",
    "ResourceExhausted",
    "Samples",
    "ServerLost",
    "SettingsError",
    "TaxelError",
    "Timing",
    "Unavailable",
    "WindowSpec",
    "WindowStream",
    "Windows",
    "build_windows",
    "connect",
    "connect_async",
    "load",
]


def __getattr__(name: str) -> Any:
    home = _HOME_OF.get(name)
    if home is None:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(f"{__name__}.{home}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
