"""The metadata of the server and its models: every answer that needs no evaluation."""

from collections.abc import Callable
from dataclasses import asdict
from typing import Any, Final

from taxel import __version__
from taxel.errors import NotFound, PermissionDenied, Unavailable
from taxel.lane.offer import LaneOffer
from taxel.protocol import CANCEL
from taxel_server.core.server_statistics import ServerStatistics
from taxel_server.core.traffic import Traffic
from taxel_server.engine import Engine, LoadedModel

EXTENSIONS: Final = ("repository_index", "model_repository", "model_stats", "server_stats", CANCEL)
MODEL_EXTENSIONS: Final = (CANCEL,)
"""What a client may do beyond plain requests: told with each model, which every client asks for."""


class ServerMetadata:
    """Answers by the part of the key below the prefix, as the Open Inference Protocol says.

    Args:
        engine: whose models these are.
        ready: whether the server takes requests.
        statistics: what the server and its models have done.
        lane: where clients on this machine may ask, too.
        traffic: what clients ask; None if nobody may watch it.
    """

    def __init__(
        self,
        engine: Engine,
        ready: Callable[[], bool],
        statistics: ServerStatistics,
        lane: Callable[[], LaneOffer | None],
        traffic: Traffic | None = None,
    ) -> None:
        self._engine = engine
        self._ready = ready
        self._statistics = statistics
        self._lane = lane
        self._traffic = traffic

    def answer(self, path: str) -> dict[str, Any]:
        """The answer to a path such as `v2/health/ready`.

        Raises:
            NotFound: no such path, model or version.
            PermissionDenied: the server may not be watched.
            Unavailable: the model cannot be loaded.
        """
        match path.split("/"):
            case ["v2"]:
                return self._describe()
            case ["v2", "stats"]:
                return self._statistics.read()
            case ["v2", "watch"]:
                return self._look()
            case ["v2", "health", "live"]:
                return {"live": True}
            case ["v2", "health", "ready"]:
                return {"ready": self._ready()}
            case ["v2", "repository", "index"]:
                return {"models": [asdict(model) for model in self._engine.models()]}
            case ["v2", "models", name, "versions", version, *action] if len(action) <= 1:
                return self._answer_model(path, name, version, action)
            case ["v2", "models", name, *action] if len(action) <= 1:
                return self._answer_model(path, name, None, action)
        raise NotFound(f"no key {path!r} below the server's prefix")

    def _describe(self) -> dict[str, Any]:
        described = {"name": "taxel", "version": __version__, "extensions": list(EXTENSIONS)}
        lane = self._lane()
        return described if lane is None else {**described, "lane": lane._asdict()}

    def _look(self) -> dict[str, Any]:
        if self._traffic is None:
            raise PermissionDenied("this server may not be watched: expected one with --watchable")
        return self._traffic.look()

    def _answer_model(self, path: str, name: str, version: str | None, action: list[str]) -> dict[str, Any]:
        match action:
            case []:
                return self._metadata(self._engine.model(name, version))
            case ["ready"]:
                return {"ready": self._model_ready(name, version)}
            case ["stats"]:
                return self._statistics.of_model(self._engine.model(name, version))
            case ["infer"]:
                # Only an inference request for an unknown model comes here.
                self._engine.model(name, version)
        raise NotFound(f"no key {path!r} below the server's prefix")

    def _model_ready(self, name: str, version: str | None) -> bool:
        try:
            self._engine.model(name, version)
        except Unavailable:
            return False
        return self._ready()

    def _metadata(self, described_model: LoadedModel) -> dict[str, Any]:
        manifest = described_model.manifest
        versions = [
            model.version
            for model in self._engine.models()
            if model.name == manifest.name and model.state == "READY"
        ]
        described = manifest.model_dump(mode="json")
        return {
            "name": manifest.name,
            "versions": versions,
            "platform": manifest.platform,
            "inputs": described["inputs"],
            "outputs": described["outputs"],
            "parameters": {
                "manifest": described,
                "evaluators": described_model.evaluators,
                "extensions": list(MODEL_EXTENSIONS),
            },
        }
