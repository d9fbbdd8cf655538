"""The engine: a repository of artifacts and the runtimes that evaluate them; knows no transport."""

import logging
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from threading import Lock
from typing import Final

import numpy as np
from numpy.typing import NDArray

from taxel import artifacts
from taxel.arguments import checked_version
from taxel.channels import CHANNELS
from taxel.errors import ArtifactError, NotFound, TaxelError, Unavailable
from taxel.manifest import Manifest
from taxel.predictor import ModelInfo
from taxel_server.runtimes import DEFAULTS, Runtime, RuntimeOptions, check_platform, open_runtime
from taxel_server.runtimes.corrected import CorrectedRuntime

_LOG: Final = logging.getLogger(__name__)

_WARM_UP_ROWS: Final = (1, 8, 64, 512)
"""Runtimes choose a method by the number of rows; each method runs once before it serves."""

_MANY_ROWS: Final = 1024
"""Rows of a full batch at the server's default setting."""


Place = tuple[str, str]
"""A version's place in the repository: name and version."""

UNLOADED: Final = "it was unloaded"
"""Why a version is not there that an operator took away."""


@dataclass(frozen=True, eq=False)
class LoadedModel:
    """One version of a model, ready to evaluate."""

    manifest: Manifest
    runtime: Runtime

    @property
    def label(self) -> str:
        """Name and version, for messages."""
        return self.manifest.label

    @cached_property
    def features(self) -> int:
        """Values in one window."""
        return len(self.manifest.window.features)

    @cached_property
    def columns(self) -> int:
        """The number of outputs: 21 channels, and 21 spreads if the model gives them."""
        return len(CHANNELS) * len(self.manifest.outputs)

    @property
    def evaluators(self) -> dict[str, str]:
        """What evaluates one window and many, and with which instructions, as in `ModelInfo`."""
        one, many = self.runtime.evaluator(1), self.runtime.evaluator(_MANY_ROWS)
        return {"one_row": one.name, "many_rows": many.name, "instruction_set": one.instruction_set}

    def evaluate(self, windows: NDArray[np.float32]) -> NDArray[np.float32]:
        """Counts (n, columns) float32 of windows (n, f) float32, already checked."""
        return self.runtime.evaluate(windows)

    def evaluate_base(self, windows: NDArray[np.float32]) -> NDArray[np.float32]:
        """The same before the effects are added."""
        if isinstance(self.runtime, CorrectedRuntime):
            return self.runtime.evaluate_base(windows)
        return self.runtime.evaluate(windows)


class Engine:
    """Every version of every model in a repository, loaded when first asked for. Thread-safe.

    A damaged artifact is `UNAVAILABLE` with its reason, and does not stop the others.

    Args:
        repository: folder of `<name>/<version>/` artifacts.
        options: options of the evaluation.

    Raises:
        ArtifactError: the repository is no folder.
    """

    def __init__(self, repository: Path, options: RuntimeOptions = DEFAULTS) -> None:
        self._repository = repository
        self.options: Final = options
        self._versions: dict[str, list[str]] = {}
        self._outcomes: dict[Place, LoadedModel | str] = {}
        """The result of each load: a model, or the reason why there is none."""
        self._held: dict[Place, str] = {}
        """Versions that somebody else will `load`, `put` or `refuse`, and why they are not there yet."""
        self._notes: dict[Place, str] = {}
        """Why versions that are served were not loaded again."""
        self._shadows: set[Place] = set()
        self._lock = Lock()
        self.scan()

    def scan(self, hold: str | None = None) -> list[Place]:
        """Look into the repository again.

        Args:
            hold: `hold` new versions, with this reason.

        Returns:
            The versions that are not loaded: new ones, and those that could not be loaded before.

        Raises:
            ArtifactError: the repository is no folder.
        """
        found = {}
        for name in artifacts.names(self._repository):
            try:
                found[name] = artifacts.versions(self._repository, name)
            except (OSError, NotFound) as error:
                _LOG.warning("model %s is left out: %s", name, error)
        with self._lock:
            # A version that is served stays, even where its folder has gone.
            for name, version in self._outcomes:
                if isinstance(self._outcomes[name, version], LoadedModel):
                    found[name] = sorted({*found.get(name, ()), version}, key=int)
            self._versions = dict(sorted(found.items()))
            places = [(name, version) for name, versions in found.items() for version in versions]
            missing = [place for place in places if not isinstance(self._outcomes.get(place), LoadedModel)]
            if hold is not None:
                new = (place for place in missing if place not in self._outcomes)
                self._held.update(dict.fromkeys(new, hold))
            return missing

    def folder(self, place: Place) -> Path:
        """The folder of a version."""
        return self._repository.joinpath(*place)

    def hold(self, places: Iterable[Place], reason: str) -> None:
        """Keep versions from being loaded when they are asked for, until they are settled."""
        with self._lock:
            self._held.update(dict.fromkeys(places, reason))

    def load(self, place: Place) -> LoadedModel | str:
        """Load a version that was held; requests to others go on meanwhile.

        Returns:
            The model, or the reason why there is none.
        """
        return self._settle(place, self._load(*place))

    def put(self, place: Place, model: LoadedModel, *, shadow: bool = False) -> None:
        """Serve a version that was loaded elsewhere, from now on and instead of what was there.

        Args:
            place: of the version.
            model: the loaded version.
            shadow: whether `newest` passes it over.
        """
        with self._lock:
            if shadow:
                self._shadows.add(place)
            else:
                self._shadows.discard(place)
        self._settle(place, model)

    def refuse(self, place: Place, reason: str) -> str:
        """Do not load a version; returns the reason. One that is served is served on, with this note."""
        with self._lock:
            served = isinstance(self._outcomes.get(place), LoadedModel)
            if served:
                self._notes[place] = reason
                self._held.pop(place, None)
        if served:
            _LOG.warning("model %s/%s is served on, but was not loaded again: %s", *place, reason)
        else:
            _LOG.warning("model %s/%s is unavailable: %s", *place, reason)
            self._settle(place, reason)
        return reason

    def unload(self, place: Place) -> None:
        """Serve a version no more, until it is loaded again.

        Raises:
            NotFound: it is not loaded.
        """
        with self._lock:
            if not isinstance(self._outcomes.get(place), LoadedModel):
                raise NotFound("version {1} of model {0!r} is not loaded".format(*place))
        self._settle(place, UNLOADED)

    def outcome(self, place: Place) -> LoadedModel | str | None:
        """A loaded version, or the reason why it is none; None if nobody has tried to load it."""
        with self._lock:
            return self._outcomes.get(place)

    def newest(self, name: str) -> LoadedModel | None:
        """The version that answers requests for a model without a version; None if none is loaded."""
        with self._lock:
            for version in reversed(self._versions.get(name, [])):
                outcome = self._outcomes.get((name, version))
                if isinstance(outcome, LoadedModel) and (name, version) not in self._shadows:
                    return outcome
        return None

    def shadows(self, name: str) -> list[LoadedModel]:
        """The versions of a model that are loaded as shadows."""
        with self._lock:
            outcomes = [self._outcomes.get(place) for place in sorted(self._shadows) if place[0] == name]
        return [outcome for outcome in outcomes if isinstance(outcome, LoadedModel)]

    def _settle(self, place: Place, outcome: LoadedModel | str) -> LoadedModel | str:
        with self._lock:
            self._outcomes[place] = outcome
            self._held.pop(place, None)
            self._notes.pop(place, None)
            if not isinstance(outcome, LoadedModel):
                self._shadows.discard(place)
        return outcome

    def load_all(self) -> list[LoadedModel]:
        """Load and warm up every version of every model that is not held; returns those that loaded."""
        outcomes = [
            self._outcome(name, version)
            for name, versions in self._versions.items()
            for version in versions
        ]
        return [outcome for outcome in outcomes if isinstance(outcome, LoadedModel)]

    def loaded(self) -> list[LoadedModel]:
        """The versions that are loaded now, in the order of `models`."""
        with self._lock:
            outcomes = [
                self._outcomes.get((name, version))
                for name, versions in self._versions.items()
                for version in versions
            ]
        return [outcome for outcome in outcomes if isinstance(outcome, LoadedModel)]

    def models(self) -> list[ModelInfo]:
        """Every version of every model, sorted.

        For a model that was not loaded yet, `READY` means that its artifact is sound and that the
        libraries of its runtime can be imported.
        """
        return [
            self._info(name, version) for name, versions in self._versions.items() for version in versions
        ]

    def model(self, name: str, version: str | None = None) -> LoadedModel:
        """One version of a model; if none is named, the newest that can be loaded.

        Raises:
            NotFound: there is no such model or version; the text lists those there are.
            Unavailable: it cannot be loaded; the text says why.
            InvalidArgument: the version is no text.
        """
        versions = self._versions_of(name, checked_version(version))
        reasons = []
        for candidate in reversed(versions):
            if version is None and (name, candidate) in self._shadows:
                reasons.append(f"version {candidate}: it is a shadow")
                continue
            outcome = self._outcome(name, candidate)
            if isinstance(outcome, LoadedModel):
                return outcome
            reasons.append(f"version {candidate}: {outcome}")
        raise Unavailable(f"model {name!r} cannot be loaded: {'; '.join(reasons)}")

    def _versions_of(self, name: str, version: str | None) -> list[str]:
        versions = self._versions.get(name, [])
        if not versions:
            known = ", ".join(name for name, versions in self._versions.items() if versions)
            raise NotFound(f"no model {name!r}; there is: {known or 'none'}")
        if version is None:
            return versions
        if version not in versions:
            raise NotFound(f"model {name!r} has no version {version!r}; it has: {', '.join(versions)}")
        return [version]

    def _outcome(self, name: str, version: str) -> LoadedModel | str:
        place = (name, version)
        with self._lock:
            if (held := self._held.get(place)) is not None:
                return held
            if place not in self._outcomes:
                self._outcomes[place] = self._load(name, version)
            return self._outcomes[place]

    def _load(self, name: str, version: str) -> LoadedModel | str:
        try:
            return load_model(self._repository / name / version, self.options)
        except TaxelError as error:
            reason = str(error)
            _LOG.warning("model %s/%s is unavailable: %s", name, version, reason)
        except Exception as error:
            # A runtime's fault on one artifact must not stop the other models.
            reason = f"its runtime failed: {error!r}"
            _LOG.exception("model %s/%s is unavailable", name, version)
        return reason

    def _info(self, name: str, version: str) -> ModelInfo:
        place = (name, version)
        found = self._held.get(place) or self._outcomes.get(place) or self._examined(name, version)
        if isinstance(found, str):
            return ModelInfo(name, version, "UNAVAILABLE", found, platform="", combination=None)
        manifest = found.manifest
        evaluators = found.evaluators if isinstance(found, LoadedModel) else {}
        return ModelInfo(
            name,
            version,
            "READY",
            self._notes.get(place, ""),
            manifest.platform,
            manifest.window.combination,
            **evaluators,
            shadow=place in self._shadows,
            delay_s=manifest.spec.delay_s,
            warm_up_s=manifest.spec.warm_up_s,
            norm_mae=None if manifest.training is None else manifest.training.held_out_norm_mae,
        )

    def _examined(self, name: str, version: str) -> artifacts.Artifact | str:
        try:
            artifact = artifacts.read(self._repository / name / version)
            check_platform(artifact.manifest.platform)
        except TaxelError as error:
            return str(error)
        return artifact


def load_model(folder: Path, options: RuntimeOptions = DEFAULTS) -> LoadedModel:
    """Read, open and warm up the artifact in a folder.

    Raises:
        ArtifactError: it is damaged, inconsistent or not supported, or predicts no finite counts.
        MissingDependency: its runtime's library is not installed.
    """
    artifact = artifacts.read(folder)
    model = LoadedModel(artifact.manifest, open_runtime(artifact, options))
    window = np.asarray(artifact.manifest.typical_window, dtype=np.float32)
    for rows in _WARM_UP_ROWS:
        outputs = model.evaluate(np.tile(window, (rows, 1)))
        if outputs.shape != (rows, model.columns):
            raise ArtifactError(f"{folder}: predicts {outputs.shape}, expected {(rows, model.columns)}")
        if not np.isfinite(outputs).all():
            raise ArtifactError(f"{folder}: predicts values that are not finite for a mean window")
    return model
