"""Times a forest with everything switched on, and with each switch off, in turn."""

from collections.abc import Callable, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from taxel.manifest import Normalisation
from taxel_bench.progress import Watch, ignore
from taxel_bench.timing import TimedCalls, interleaved
from taxel_server.runtimes.trees.autotune import Autotuned
from taxel_server.runtimes.trees.normalisation import Scales
from taxel_server.runtimes.trees.reading.forest import Forest
from taxel_server.runtimes.trees.reading.xgboost_json import read_forest
from taxel_server.runtimes.trees.switches import ALL_ON

NAMES: Final = tuple(field.name for field in fields(ALL_ON))

EVICTION_BYTES: Final = 64 * 2**20
"""What is read and written before a cold call, so that the caches hold nothing else if they are smaller."""

_WINDOWS: Final = 64
"""Different batches of windows that the calls take in turn."""

Say = Callable[[str], None]


class Absences:
    """One forest, laid out with all switches on and with each of some off.

    Args:
        path: XGBoost's JSON model file.
        switches: names of switches.
        say: told what is being laid out.
    """

    def __init__(self, path: Path, switches: Sequence[str], say: Say) -> None:
        forest = read_forest(path)
        scales = _unscaled(forest)
        self._features, self._outputs = forest.features, len(forest.base_score)
        self._evaluated = dict[str, Autotuned]()
        for name in ("", *switches):
            say(f"laying out {path.name} {f'without {name}' if name else ''}")
            chosen = replace(ALL_ON, **{name: False}) if name else ALL_ON
            self._evaluated[name] = Autotuned.of(forest, scales, chosen)
        self._eviction = np.zeros(EVICTION_BYTES // 8)

    def measure(
        self, rows: int, repetitions: int, seed: int, watch: Watch = ignore
    ) -> list[dict[str, Any]]:
        """One result for everything on, and one for each switch; see bench/README.md for the fields."""
        shape = _WINDOWS, rows, self._features
        windows = np.random.default_rng(seed).standard_normal(shape).astype(np.float32)
        result = np.empty((rows, self._outputs), dtype=np.float32)
        # Three calls each: what empties the caches, a cold evaluation, and a warm one.
        calls = [
            call
            for forest in self._evaluated.values()
            for call in (self._evict, *(_evaluation(forest, windows, result, by) for by in (0, 1)))
        ]
        timed = interleaved(calls, repetitions=repetitions, seed=seed, together=3, watch=watch)
        cold, warm = timed[1::3], timed[2::3]
        return [
            {
                "rows": rows,
                "without": name,
                "evaluator": forest.evaluator_of(rows).name,
                "repetitions": repetitions,
                **_figures("cold", cold[place], cold[0]),
                **_figures("warm", warm[place], warm[0]),
            }
            for place, (name, forest) in enumerate(self._evaluated.items())
        ]

    def _evict(self, _number: int) -> None:
        self._eviction += 1.0


def _evaluation(
    forest: Autotuned, windows: NDArray[np.float32], result: NDArray[np.float32], shift: int
) -> Callable[[int], None]:
    return lambda number: forest.evaluate(windows[(number + shift) % _WINDOWS], result)


def _figures(name: str, calls: TimedCalls, complete: TimedCalls) -> dict[str, float]:
    """Medians, and the factor by which a call is slower than the complete forest in the same round."""
    return {
        f"{name}_ms": calls.median_ms,
        f"{name}_cpu_ms": calls.cpu_median_ms,
        f"{name}_cost": float(np.median(calls.cpu_seconds / complete.cpu_seconds)) - 1,
    }


def _unscaled(forest: Forest) -> Scales:
    inputs, outputs = (0.0,) * forest.features, (0.0,) * len(forest.base_score)
    ones_in, ones_out = (1.0,) * forest.features, (1.0,) * len(forest.base_score)
    normalisation = Normalisation(
        input_mean=inputs, input_std=ones_in, output_mean=outputs, output_std=ones_out, folded=True
    )
    return Scales.of(normalisation)
