"""The recovery benchmark: injects effects; the loop must find them without knowing which they are."""

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, Final

import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict, Field

from taxel.channels import COUNTS_MAX
from taxel.schema import Schema
from taxel_models.loop.basis import Floats
from taxel_models.loop.blocks import cut
from taxel_models.loop.effects.registry import NAMES, candidates
from taxel_models.loop.inference.constants import DECLARED
from taxel_models.loop.inference.selection import JointSelection
from taxel_models.loop.observations import Model, Observations, gather
from taxel_models.loop.pipeline import LoopResult, LoopSettings, run_loop
from taxel_models.recordings import Recording
from taxel_models.recovery.injection import Injection
from taxel_models.recovery.injectors import inject
from taxel_models.recovery.unknown import UNKNOWN
from taxel_models.twin import simulate

NONE: Final = "none"
UNEXPLAINED: Final = "unexplained"

CLEAN_SHARE: Final = 0.2
UNKNOWN_SHARE: Final = 0.1
STRENGTHS: Final = (0.5, 2.0)
"""The least and greatest strength over the residual; strengths are drawn evenly in the logarithm."""

CLEANINGS: Final = 5
WORTH_REMOVING: Final = 0.02
"""The least share of the error that the truth itself must remove for the round to be scored."""

FIGURES: Final = {"creep": "time_constant", "lag": "lag", "frame": "angle"}
"""Parameters that are scored: time constants, delays, angles."""


class Round(Schema):
    """One round.

    Attributes:
        truth: the injected effect, `none`, or `unknown:NAME`.
        strength: over the residual before.
        injected: the effect's parameters; `planted` in JSON.
        found: the effect that explains most, `none` where nothing was named, `unexplained` where
            nothing was named and what is left is structured.
        named: all that were named.
        right: whether the first is the truth, nothing was named where there was nothing, or what no
            effect describes was left unexplained.
        clean: normalised MAE on the evaluation blocks without the injected effect.
        before: with it.
        after: with the correction.
        removed: share of the removable error that was removed; None where there was none to speak of.
        parameter_error: of the figure that is marked, relative; None where there is none.
    """

    model_config = ConfigDict(populate_by_name=True)

    number: int
    truth: str
    strength: float
    injected: Annotated[dict[str, Any], Field(alias="planted")]
    found: str
    named: tuple[str, ...]
    right: bool
    confounded: bool
    clean: float
    before: float
    after: float
    removed: float | None
    parameter_error: float | None


class Summary(Schema):
    """What the rounds come to.

    Attributes:
        confusion: for each truth, how often each effect was found first.
        right_first: share of the rounds with an injected effect in which it was found first.
        right_or_confounded: likewise, or was reported as one that cannot be told from it.
        false_alarms: share of the clean rounds in which anything was named.
        unknown_left: share of the rounds with an unknown cause in which nothing was named.
        removed: median share of the removable error that was removed where the effect was right.
        removed_mean: its mean, weighed by what there was to remove.
        parameters_within: share of the marked parameters within 20 %.
    """

    rounds: int
    confusion: dict[str, dict[str, int]]
    right_first: float | None
    right_or_confounded: float | None
    false_alarms: float | None
    unknown_left: float | None
    removed: float | None
    removed_mean: float | None
    parameters_within: float | None


@dataclass(frozen=True)
class RecoverySettings:
    """What is injected, and how often.

    Attributes:
        rounds: how many.
        seed: of recordings, effects and strengths.
        rows: of each recording.
        recordings: different ones, taken in turn.
        effects: that may be injected.
        strengths: least and greatest.
    """

    rounds: int
    seed: int = 0
    rows: int = 60_000
    recordings: int = 5
    effects: tuple[str, ...] = NAMES
    strengths: tuple[float, float] = STRENGTHS


def run_rounds(
    model: Model, settings: RecoverySettings, note: Callable[[str], None] | None = None
) -> Iterator[Round]:
    """Round after round: the loop sees a recording and nothing else."""
    clean: dict[int, Recording] = {}
    for number in range(settings.rounds):
        random = np.random.default_rng([settings.seed, number])
        which = number % settings.recordings
        if which not in clean:
            simulated = simulate(settings.rows, 1000 * (settings.seed + 1) + which)
            clean[which] = without_effects(model, simulated, which)
        yield run_round(model, clean[which], _draw(random, settings), number, random, note)


def without_effects(model: Model, recording: Recording, seed: int) -> Recording:
    """A recording without the effects that the loop finds before any injection.

    Effects of a quarter of the naming threshold are taken out, too, so that another split names none.
    """
    recording = recording.ticks()
    for _ in range(CLEANINGS):
        observations = gather(model, [recording], measured_temperature=True)
        blocks = cut(observations, seed=seed)
        selection = JointSelection(
            observations,
            blocks,
            candidates(observations),
            reference=model.manifest.held_out_residual,
            constants=replace(DECLARED, least_share=DECLARED.least_share / 4),
        )
        named = selection.run().named
        if not named:
            break
        channels = recording.channels.copy()
        channels[observations.rows[0]] -= sum(effect.contribution for effect in named)
        recording = replace(recording, channels=np.clip(np.rint(channels), 0, COUNTS_MAX))
    return recording


def run_round(
    model: Model,
    recording: Recording,
    drawn: tuple[str, float],
    number: int,
    random: np.random.Generator,
    note: Callable[[str], None] | None = None,
) -> Round:
    """Injects an effect, runs the loop and scores the result."""
    truth, strength = drawn
    base = gather(model, [recording], measured_temperature=True)
    residual = np.sqrt((base.residual**2).mean(axis=0))
    injection = Injection.into(recording, int(random.integers(1 << 30)), residual)
    injection.respond = _responding(model, recording)
    inject_truth(injection, truth, strength)
    result = run_loop(model, [injection.recording], LoopSettings(seed=number), note)
    return _marked(number, truth, strength, injection, base, result)


def _responding(model: Model, recording: Recording) -> Callable[[Floats, Floats], Floats]:
    """What the model gives for other inputs, at every tick; 0 where a tick has no whole window."""

    def respond(position: Floats, force: Floats) -> Floats:
        samples = replace(recording.samples, position=position, force=force)
        moved = gather(model, [replace(recording, samples=samples)], measured_temperature=True)
        counts = np.zeros((len(recording), moved.predicted.shape[1]))
        counts[moved.rows[0]] = moved.predicted
        return counts

    return respond


def inject_truth(injection: Injection, truth: str, strength: float) -> None:
    """Put an effect, or a cause that no effect describes, into a recording."""
    kind, _, name = truth.partition(":")
    if kind == "unknown":
        injection.begin(truth, strength)
        UNKNOWN[name](injection)
    elif truth != NONE:
        inject(injection, truth, strength)


def summarise(rounds: Sequence[Round]) -> Summary:
    """Counts the rounds' outcomes."""
    confusion: dict[str, Counter[str]] = {}
    for finished in rounds:
        confusion.setdefault(finished.truth, Counter())[finished.found] += 1
    injected = [finished for finished in rounds if finished.truth in NAMES]
    right = [finished for finished in injected if finished.right]
    marked = [finished for finished in right if finished.removed is not None]
    weight = sum(finished.before - finished.clean for finished in marked)
    return Summary(
        rounds=len(rounds),
        confusion={truth: dict(counts) for truth, counts in sorted(confusion.items())},
        right_first=_share([finished.right for finished in injected]),
        right_or_confounded=_share([finished.right or finished.confounded for finished in injected]),
        false_alarms=_share([bool(finished.named) for finished in rounds if finished.truth == NONE]),
        unknown_left=_share(
            [finished.right for finished in rounds if finished.truth.startswith("unknown:")]
        ),
        removed=float(np.median([finished.removed for finished in marked])) if marked else None,
        removed_mean=sum(finished.before - finished.after for finished in marked) / weight
        if weight
        else None,
        parameters_within=_share(
            [finished.parameter_error <= 0.2 for finished in right if finished.parameter_error is not None]
        ),
    )


def _draw(random: np.random.Generator, settings: RecoverySettings) -> tuple[str, float]:
    least, greatest = np.log(settings.strengths)
    strength = float(np.exp(random.uniform(least, greatest)))
    dice = float(random.random())
    if dice < CLEAN_SHARE:
        return NONE, 0.0
    if dice < CLEAN_SHARE + UNKNOWN_SHARE:
        return f"unknown:{random.choice(sorted(UNKNOWN))}", strength
    return str(random.choice(settings.effects)), strength


def _marked(
    number: int, truth: str, strength: float, injection: Injection, base: Observations, result: LoopResult
) -> Round:
    findings = result.findings
    named = tuple(effect.name for effect in findings.effects)
    left = UNEXPLAINED if findings.unexplained.structured else NONE
    found = named[0] if named else left
    output_std = np.array(base.manifest.normalisation.output_std)
    rows = result.blocks.evaluation
    clean = _norm_mae(base.measured, base.predicted, rows, output_std)
    before, after = findings.before["norm_mae"], findings.after["norm_mae"]
    removable = before - clean
    unknown = truth.startswith("unknown:")
    served = all(effect.served for effect in findings.effects)
    return Round(
        number=number,
        truth=truth,
        strength=strength,
        injected=injection.truth[0].get("parameters", {}) if injection.truth else {},
        found=found,
        named=named,
        right=not named if truth == NONE or unknown else found == truth,
        confounded=any(truth in effect.confounded_with for effect in findings.effects),
        clean=clean,
        before=before,
        after=after,
        removed=(before - after) / removable if removable > WORTH_REMOVING * before and served else None,
        parameter_error=_parameter_error(truth, injection, result),
    )


def _norm_mae(measured: Floats, predicted: Floats, rows: NDArray[np.bool_], output_std: Floats) -> float:
    return float((np.abs(measured - predicted)[rows].mean(axis=0) / output_std).mean())


def _parameter_error(truth: str, injection: Injection, result: LoopResult) -> float | None:
    if truth not in FIGURES:
        return None
    injected = float(injection.truth[0]["parameters"][FIGURES[truth]])
    for effect in result.findings.effects:
        if effect.name == truth:
            for figure in effect.parameters:
                if figure.name == FIGURES[truth]:
                    return abs(figure.value - injected) / abs(injected)
    return None


def _share(marks: Sequence[bool]) -> float | None:
    return sum(marks) / len(marks) if marks else None
