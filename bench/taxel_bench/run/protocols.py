"""How one model is timed in this process, ours and the published way in turn: two protocols."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from taxel.channels import CHANNELS
from taxel_bench.agreement import largest_difference
from taxel_bench.conditions import disturbances, stolen_time
from taxel_bench.engines import THREADS, Engine
from taxel_bench.subjects import Subject, random_windows
from taxel_bench.timing import Call, TimedCalls, interleaved, warm_up
from taxel_bench.verdict import queries_for, too_few, verdict

DISTINCT_INPUTS: Final = 256
"""Different inputs that are cycled through, so that no branch predictor learns one by heart."""

PAPER_WARM_UP: Final = 10
PAPER_WINDOWS: Final = 100
"""Calls that the published scripts made before timing, and timed."""

_WARM_UP: Final = 50
_WARM_UP_SHARE: Final = 0.05
_WARM_SHARE: Final = 0.1
"""Of the allowed time: for warming up, and for what is timed back to back afterwards."""

_FEWEST: Final = 10


@dataclass(frozen=True)
class Effort:
    """How much is measured at one batch size.

    Attributes:
        repetitions: timed calls of each engine; as many as p99 needs if None, fewer where they would
            take longer than `seconds`.
        seconds: longest time for the calls, where `repetitions` does not say how many.
        seed: of the windows.
    """

    repetitions: int | None = None
    seconds: float = 60.0
    seed: int = 0

    def rounds(self, round_s: float) -> int:
        """Timed rounds where one takes `round_s`."""
        return self.repetitions or min(queries_for(99), self._fitting(round_s, 1.0))

    def warm_rounds(self, round_s: float) -> int:
        """Timed rounds of what is timed beside: no more, and within its share of the time."""
        return min(self.repetitions or queries_for(99), self._fitting(round_s, _WARM_SHARE))

    def _fitting(self, round_s: float, share: float) -> int:
        return max(_FEWEST, int(share * self.seconds / round_s))


def run_serving(
    subject: Subject,
    batches: Sequence[int],
    effort: Effort,
    watch: Callable[[int], None] = lambda _: None,
) -> list[dict[str, Any]]:
    """Time both engines in turn at each batch size; two results for each, as `--json` prints them.

    `watch` is told after each batch size how many are done.
    """
    results = []
    for done, batch in enumerate(batches, start=1):
        results += _serve_batch(subject, batch, effort)
        watch(done)
    return results


def run_paper(subject: Subject, effort: Effort) -> list[dict[str, Any]]:
    """What the published scripts measured: 100 single windows after 10, mean and standard deviation."""
    windows = random_windows(subject.manifest, PAPER_WINDOWS, effort.seed)
    difference = largest_difference(subject, windows)
    calls = [_call(engine, np.split(windows, len(windows))) for engine in subject.engines]
    warm_up(calls, rounds=PAPER_WARM_UP, seconds=effort.seconds)
    with stolen_time() as stolen:
        taken = interleaved(calls, repetitions=effort.repetitions or PAPER_WINDOWS)
    results = []
    for engine, timed in zip(subject.engines, taken, strict=True):
        mean, std = float(timed.seconds.mean()) * 1e3, float(timed.seconds.std()) * 1e3
        result = _result(subject, engine, 1, timed, "paper", difference, stolen())
        result |= {"mean_ms": mean, "std_ms": std}
        if engine.name == "paper" and subject.manifest.platform == "xgboost_json":
            result["mean_ms_per_channel"] = mean / len(CHANNELS)
        results.append(result)
    return _with_ratio(results, "mean_ms", "ratio")


def _serve_batch(subject: Subject, batch: int, effort: Effort) -> list[dict[str, Any]]:
    distinct = max(1, DISTINCT_INPUTS // batch)
    windows = random_windows(subject.manifest, distinct * batch, effort.seed)
    inputs = np.split(windows, distinct)
    difference = largest_difference(subject, inputs[0])
    calls = [_call(engine, inputs) for engine in subject.engines]
    round_s = warm_up(calls, rounds=_WARM_UP, seconds=_WARM_UP_SHARE * effort.seconds)
    with stolen_time() as stolen:
        taken = interleaved(calls, repetitions=effort.rounds(round_s))

    def predicting(number: int) -> object:
        return subject.predict(inputs[number % distinct])

    # In the order of the engines; ours is last, and what a user calls is timed beside it.
    alone = [_back_to_back([call], effort)[0] for call in calls[:-1]]
    alone += _back_to_back([calls[-1], predicting], effort)
    results = []
    for engine, timed, warm in zip(subject.engines, taken, alone, strict=False):
        result = _result(subject, engine, batch, timed, "serving", difference, stolen())
        results.append(result | {"warm_median_ms": warm.median_ms})
    results[-1]["predictor_warm_median_ms"] = alone[-1].median_ms
    for figure in ("median", "cpu_median", "warm_median"):
        _with_ratio(results, f"{figure}_ms", f"{figure.removesuffix('median')}ratio")
    return results


def _call(engine: Engine, inputs: Sequence[NDArray[np.float32]]) -> Call:
    """A call on each input in turn; making them ready for the engine is not timed."""
    prepared = [engine.prepare(each) for each in inputs]
    return lambda number: engine.evaluate(prepared[number % len(prepared)])


def _back_to_back(calls: Sequence[Call], effort: Effort) -> list[TimedCalls]:
    """Calls of one engine by themselves, so that they find their own data in the caches."""
    round_s = warm_up(calls, rounds=_WARM_UP, seconds=_WARM_UP_SHARE * _WARM_SHARE * effort.seconds)
    return interleaved(calls, repetitions=effort.warm_rounds(round_s))


def _result(
    subject: Subject,
    engine: Engine,
    batch: int,
    timed: TimedCalls,
    protocol: str,
    difference: float | None,
    stolen: float,
) -> dict[str, Any]:
    return {
        "model": subject.model,
        "inputs": subject.manifest.window.combination,
        "size": subject.size,
        "trees": subject.trees,
        "protocol": protocol,
        "engine": engine.name,
        "how": engine.how,
        "threads": THREADS,
        "batch": batch,
        **timed.report(),
        "cpu_median_ms": timed.cpu_median_ms,
        "rows_per_s": batch / (timed.median_ms / 1e3),
        "parameters": subject.manifest.parameters,
        "flops": engine.flops,
        "largest_difference": difference,
        **verdict([*too_few(len(timed.seconds), 99), *disturbances(timed, stolen)]),
        "notes": list(subject.notes),
    }


def _with_ratio(results: list[dict[str, Any]], figure: str, ratio: str) -> list[dict[str, Any]]:
    """Adds to our result how many times faster it is than the published way's, if there is one."""
    by_engine = {result["engine"]: result for result in results}
    if "paper" in by_engine:
        by_engine["taxel"][ratio] = by_engine["paper"][figure] / by_engine["taxel"][figure]
    return results
