"""How one model is timed in this process, our runtime and other engines in turn: two protocols."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from taxel.channels import CHANNELS
from taxel_bench.agreement import compare_answers
from taxel_bench.conditions import disturbances, stolen_time
from taxel_bench.engines import PUBLISHED, THREADS, Engine
from taxel_bench.progress import Watch, ignore, shifted
from taxel_bench.run.comparing import compare_engines
from taxel_bench.subjects.subject import Subject
from taxel_bench.timing import Call, TimedCalls, interleaved, warm_up
from taxel_bench.verdict import queries_for, too_few, verdict
from taxel_bench.windows import random_windows

DISTINCT_INPUTS: Final = 256
"""Different inputs of one window that are cycled through: no branch predictor learns one by heart."""

_FEWEST_INPUTS: Final = 4
"""Of any batch size, so that no call gets the input of the call before it."""

PAPER_WARM_UP: Final = 10
PAPER_WINDOWS: Final = 100
"""Calls that the published scripts made before timing, and timed."""

_WARM_UP: Final = 50
_WARM_UP_SHARE: Final = 0.05
_WARM_SHARE: Final = 0.1
"""The shares of the allowed time for the warm-up, and for the calls that are timed back to back."""

_FEWEST: Final = 10

_LARGEST_SHARE: Final = 0.25
"""Of the allowed time that a peer's fewest calls may take; a slower peer leaves too few to the others."""

_TRIALS: Final = 3
"""Calls of each peer before it is timed; the fastest tells how long it takes."""

_TURNS_BEGIN: Final = 0.05
_TURNS_END: Final = 0.8
"""Of a batch size's work, about: before the engines take turns, and when they have."""


@dataclass(frozen=True)
class Effort:
    """How much is measured at one batch size.

    Attributes:
        repetitions: timed calls of each engine; as many as p99 needs if None, fewer where they would
            take longer than `seconds`.
        seconds: longest time for the calls, where `repetitions` does not say how many.
        seed: of the windows, and of the order of turns.
    """

    repetitions: int | None = None
    seconds: float = 60.0
    seed: int = 0

    def rounds(self, round_s: float) -> int:
        """Timed rounds where one takes `round_s`."""
        return self.repetitions or min(queries_for(99), self._fitting(round_s, 1.0))

    def warm_rounds(self, round_s: float) -> int:
        """Rounds of calls that are timed alone: no more than the engines have, in a share of the time."""
        return min(self.repetitions or queries_for(99), self._fitting(round_s, _WARM_SHARE))

    @property
    def longest_call_s(self) -> float | None:
        """That a peer may take; None where `repetitions` says how many are made, however long."""
        return None if self.repetitions else _LARGEST_SHARE * self.seconds / _FEWEST

    def _fitting(self, round_s: float, share: float) -> int:
        return max(_FEWEST, int(share * self.seconds / round_s))


def run_serving(
    subject: Subject,
    batches: Sequence[int],
    effort: Effort,
    watch: Watch = ignore,
) -> list[dict[str, Any]]:
    """Time all engines in turn at each batch size; a result for each, as `--json` prints them.

    `watch` is told how many batch sizes are done, with the part of the one that is going on.
    """
    results = []
    for done, batch in enumerate(batches):
        results += _serve_batch(subject, batch, effort, shifted(watch, done))
    return results


def run_paper(subject: Subject, effort: Effort, watch: Watch = ignore) -> list[dict[str, Any]]:
    """What the published scripts measured: 100 single windows after 10, mean and standard deviation.

    `watch` is told which part is done.
    """
    windows = random_windows(subject.manifest, PAPER_WINDOWS, effort.seed)
    inputs = np.split(windows, len(windows))
    agreement = compare_answers(subject, subject.engines, inputs)
    engines = [engine for engine in subject.engines if engine.name not in agreement.left_out]
    calls = [_call(engine, inputs) for engine in engines]
    warm_up(calls, rounds=PAPER_WARM_UP, seconds=effort.seconds)
    with stolen_time() as stolen:
        rounds = effort.repetitions or PAPER_WINDOWS
        taken = interleaved(
            calls, repetitions=rounds, seed=effort.seed, watch=lambda done: watch(done / rounds)
        )
    results = []
    for engine, timed in zip(engines, taken, strict=True):
        mean, std = float(timed.seconds.mean()) * 1e3, float(timed.seconds.std()) * 1e3
        result = _result(subject, engine, 1, timed, "paper", agreement.differences, stolen())
        result |= {"mean_ms": mean, "std_ms": std}
        if engine.name == PUBLISHED and subject.manifest.platform == "xgboost_json":
            result["mean_ms_per_channel"] = mean / len(CHANNELS)
        results.append(result)
    if subject.peers:
        results[-1]["left_out"] = agreement.left_out
    compare_engines(results)
    return results


def _serve_batch(subject: Subject, batch: int, effort: Effort, watch: Watch) -> list[dict[str, Any]]:
    distinct = max(_FEWEST_INPUTS, DISTINCT_INPUTS // batch)
    windows = random_windows(subject.manifest, distinct * batch, effort.seed)
    inputs = np.split(windows, distinct)
    # What does not work, or is too slow, evaluates one input alone.
    working = compare_answers(subject, subject.engines, inputs[:1])
    trusted = [engine for engine in subject.engines if engine.name not in working.left_out]
    calls = {engine.name: _call(engine, inputs) for engine in trusted}
    too_slow = _too_slow(subject, calls, effort.longest_call_s)
    agreement = compare_answers(subject, [one for one in trusted if one.name not in too_slow], inputs)
    left_out = working.left_out | agreement.left_out
    engines = [engine for engine in trusted if engine.name not in (too_slow | left_out)]
    turns = [calls[engine.name] for engine in engines]
    round_s = warm_up(turns, rounds=_WARM_UP, seconds=_WARM_UP_SHARE * effort.seconds)
    rounds = effort.rounds(round_s)
    with stolen_time() as stolen:
        told = _part(watch, _TURNS_BEGIN, _TURNS_END, rounds)
        taken = interleaved(turns, repetitions=rounds, seed=effort.seed, watch=told)

    def predicting(number: int) -> object:
        # Never the input of the bare runtime's call before or after it.
        return subject.predict(inputs[(number + distinct // 2) % distinct])

    # In the order of the engines; ours is last, and what a user calls is timed beside it.
    parts = np.linspace(_TURNS_END, 1, len(turns) + 1)
    alone = []
    with stolen_time() as stolen_alone:
        for call, begin, end in zip(turns[:-1], parts[:-2], parts[1:-1], strict=True):
            alone += _back_to_back([call], effort, watch, begin, end)
        alone += _back_to_back([turns[-1], predicting], effort, watch, parts[-2], 1.0)
    results = []
    for engine, timed, warm in zip(engines, taken, alone, strict=False):
        result = _result(subject, engine, batch, timed, "serving", agreement.differences, stolen())
        results.append(result | _warm(warm, stolen_alone()))
    results[-1]["predictor_warm_median_ms"] = alone[-1].median_ms
    if subject.peers:
        longest_s = effort.longest_call_s
        results[-1] |= {
            "too_slow": too_slow,
            "too_slow_limit_ms": None if longest_s is None else longest_s * 1e3,
            "left_out": left_out,
        }
    compare_engines(results)
    return results


def _too_slow(subject: Subject, calls: Mapping[str, Call], longest_s: float | None) -> dict[str, float]:
    """Peers whose calls take longer, each with the milliseconds of a call."""
    if longest_s is None:
        return {}
    peers = [peer.name for peer in subject.peers if peer.name in calls]
    once = {name: _fastest_s(calls[name]) for name in peers}
    return {name: seconds * 1e3 for name, seconds in once.items() if seconds > longest_s}


def _fastest_s(call: Call) -> float:
    (timed,) = interleaved([call], repetitions=_TRIALS)
    return float(timed.seconds.min())


def _call(engine: Engine, inputs: Sequence[NDArray[np.float32]]) -> Call:
    """A call on each input in turn; making them ready for the engine is not timed."""
    prepared = [engine.prepare(each) for each in inputs]
    return lambda number: engine.evaluate(prepared[number % len(prepared)])


def _back_to_back(
    calls: Sequence[Call], effort: Effort, watch: Watch, begin: float, end: float
) -> list[TimedCalls]:
    """Calls of one engine alone, so that they find their own data in the caches."""
    round_s = warm_up(calls, rounds=_WARM_UP, seconds=_WARM_UP_SHARE * _WARM_SHARE * effort.seconds)
    rounds = effort.warm_rounds(round_s)
    return interleaved(calls, repetitions=rounds, watch=_part(watch, begin, end, rounds))


def _part(watch: Watch, begin: float, end: float, rounds: int) -> Callable[[int], None]:
    """Tells of rounds that lead from one part of the work to another."""
    return lambda done: watch(begin + (end - begin) * done / rounds)


def _result(
    subject: Subject,
    engine: Engine,
    batch: int,
    timed: TimedCalls,
    protocol: str,
    differences: Mapping[str, float | None],
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
        **_evaluator(subject, engine, batch),
        "batch": batch,
        **timed.report(),
        "cpu_median_ms": timed.cpu_median_ms,
        "rows_per_s": batch / (timed.median_ms / 1e3),
        "parameters": subject.manifest.parameters,
        "flops": engine.flops,
        "largest_difference": differences.get(engine.name, _of_baseline(subject, differences)),
        "rounded": engine.tolerance == math.inf,
        **verdict([*too_few(len(timed.seconds), 99), *disturbances(timed, stolen)]),
        "notes": list(subject.notes),
    }


def _warm(timed: TimedCalls, stolen: float) -> dict[str, Any]:
    """The median of calls back to back, and whether it is to be trusted."""
    found = {"median_ms": timed.median_ms, **verdict(disturbances(timed, stolen))}
    return {f"warm_{name}": value for name, value in found.items()}


def _evaluator(subject: Subject, engine: Engine, batch: int) -> dict[str, str]:
    """Which of our evaluators computes so many windows, and with which instructions."""
    if engine is not subject.taxel:
        return {}
    evaluator = subject.evaluator(batch)
    return {"evaluator": evaluator.name, "instruction_set": evaluator.instruction_set}


def _of_baseline(subject: Subject, differences: Mapping[str, float | None]) -> float | None:
    return None if subject.baseline is None else differences[subject.baseline.name]
