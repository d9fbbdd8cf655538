"""A model of a server, as requests and replies need it."""

from typing import Any, Self

from taxel.envelopes import RequestWriter
from taxel.errors import InvalidArgument
from taxel.manifest import Manifest
from taxel.predictor import Timing
from taxel.protocol import CANCEL, CANCEL_PATH, InferResponse, model_key, model_path


class RemoteModel:
    """What all requests for one model have in common.

    Args:
        manifest: of the model.
        prefix: the server's key prefix.
        cancels: whether a request can be given up.
    """

    def __init__(self, manifest: Manifest, prefix: str, *, cancels: bool = False) -> None:
        self.manifest = manifest
        self.path = model_path(manifest.name, manifest.version, "infer")
        self.key = model_key(prefix, manifest.name, manifest.version, "infer")
        self.cancel_key = f"{prefix}/{CANCEL_PATH}" if cancels else None
        self.writer = RequestWriter()

    @classmethod
    def read(cls, parameters: dict[str, Any], prefix: str) -> Self:
        """From a model's metadata.

        Raises:
            ValidationError, KeyError, TypeError: they are not a Taxel server's.
        """
        manifest = Manifest.model_validate(parameters["manifest"])
        return cls(manifest, prefix, cancels=CANCEL in parameters.get("extensions", ()))

    def check_gives_base(self) -> None:
        """Raise if a server cannot give the base.

        Raises:
            InvalidArgument: the model is corrected.
        """
        if self.manifest.effects:
            raise InvalidArgument(
                f"{self.manifest.label} is corrected, and a server gives corrected counts only: "
                "expected a model of taxel.load"
            )


def timing_of(reply: InferResponse) -> Timing:
    """How long the server took for a reply."""
    return Timing(reply.queue_us, reply.compute_us, reply.batch_rows)
