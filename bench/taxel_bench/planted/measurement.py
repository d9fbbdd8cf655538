"""Trains, exports, plants and asks the loop: by the released commands, each in a process of its own."""

import json
import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from taxel.errors import TaxelError
from taxel_bench.planted.causes import PLANTED, Planting
from taxel_bench.planted.trials import Tables, Trial, copy, found_in

TRAINED_ON: Final = 13
"""Trials of each material that the model is trained on."""

PLAYED: Final = 60
"""Trials of a recording, of those that are left."""


@dataclass(frozen=True)
class Asked:
    """What was planted in one recording, and what the loop said.

    Attributes:
        planted: causes, none to two.
        named: the loop's names, in its order.
        forms: of these.
        right: the first name is that of a planted cause, or nothing was planted and nothing named.
        before: normalised MAE of electrodes, evaluation part.
        after: with the correction.
    """

    planted: tuple[str, ...]
    named: tuple[str, ...]
    forms: tuple[str, ...]
    right: bool
    before: float
    after: float


class Planted:
    """A model of some trials, and recordings of others.

    Args:
        data: the folder of the slide recordings.
        folder: to work in.
        seed: of the trials, and of what is planted.
        one_material: a recording has trials of one material only, whichever the seed chooses.
    """

    def __init__(self, data: Path, folder: Path, seed: int, *, one_material: bool = False) -> None:
        random = np.random.default_rng([seed, 0])
        trained: list[Trial] = []
        left: list[Trial] = []
        every = found_in(data)
        materials = sorted({trial.material for trial in every})
        for material in materials:
            own = [trial for trial in every if trial.material == material]
            order = random.permutation(len(own))
            trained += [own[place] for place in order[:TRAINED_ON]]
            left += [own[place] for place in order[TRAINED_ON:]]
        if one_material:
            chosen = materials[int(random.integers(len(materials)))]
            left = [trial for trial in left if trial.material == chosen]
        order = random.permutation(len(left))[:PLAYED]
        self._tables = Tables([left[place] for place in order], data)
        self._folder, self._seed = folder, seed
        copy(trained, data, folder / "trained_on")

    def train(self) -> None:
        """Train a model and export it."""
        data, model = self._folder / "trained_on", self._folder / "model"
        _taxel("train", "--data", data, "--model", "xgb", "-o", model)
        _taxel("export", model, "--repository", self._folder / "repository")

    def ask(self, every: Sequence[tuple[str, ...]], jobs: int) -> Iterator[Asked]:
        """Plant causes and ask the loop, recording after recording.

        Args:
            every: causes of each recording.
            jobs: processes at a time.
        """
        with ThreadPoolExecutor(jobs) as pool:
            yield from pool.map(self._asked, every)

    def recording(self, causes: Sequence[str]) -> Planting:
        """With causes planted: the same ones whatever else is planted elsewhere."""
        random = np.random.default_rng([self._seed, 1, *map(list(PLANTED).index, causes)])
        planting = self._tables.planting(random)
        for cause in causes:
            PLANTED[cause][0](planting)
        return planting

    def _asked(self, causes: tuple[str, ...]) -> Asked:
        planting = self.recording(causes)
        recording = self._folder / ("+".join(causes).replace(" ", "_") or "clean")
        self._tables.write(planting, recording)
        found = json.loads(
            _taxel(
                *("loop", "--model", "xgb", "--repository", self._folder / "repository"),
                *("--data", recording, "-o", self._folder / f"report_{recording.name}", "--json"),
            )
        )
        named = tuple(effect["name"] for effect in found["effects"])
        return Asked(
            planted=causes,
            named=named,
            forms=tuple(effect["form"] for effect in found["effects"]),
            right=named[0] in {PLANTED[cause][1] for cause in causes} if named else not causes,
            before=found["before"]["norm_mae_electrodes"],
            after=found["after"]["norm_mae_electrodes"],
        )


def _taxel(*words: Any) -> str:
    """What a command prints.

    Raises:
        TaxelError: it failed; the text is what it said.
    """
    command = [str(Path(sys.executable).with_name("taxel")), *map(str, words)]
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
    if done.returncode:
        raise TaxelError(f"{' '.join(command)}: {done.stderr.strip()}")
    return done.stdout
