"""Numbers, shares, durations and an effect's parameters as a report writes them."""

from collections.abc import Iterable, Sequence
from typing import Final

from taxel.corrections import CALIBRATION_AGE, CALIBRATION_EXTRAS, Parameter
from taxel.windows import Elapsed, ExtraFeature
from taxel_models.loop.effects.registry import why_only_reported
from taxel_models.loop.findings import FoundEffect

HARMFUL: Final = 0.05
"""An effect that adds a larger share to the residual's energy on held-out blocks is told."""

_MOST_KEY_PARAMETERS: Final = 3
_MOST_NEEDS: Final = 3

_NOTHING: Final = 1e-6
"""A smaller parameter of a form tells nothing, as of an axis that nothing turns about."""


def number(value: float) -> str:
    """Three significant digits."""
    return f"{value:.0f}" if abs(value) >= 1000 else f"{value:.3g}"


def chance(p_value: float) -> str:
    """A p-value as it is written in a sentence."""
    return "p < 0.001" if p_value < 0.001 else f"p = {p_value:.2g}"


def percent(share: float) -> str:
    """A share, with a digit after the point where it is small."""
    return f"{100 * share:.1f} %" if abs(share) < 0.1 else f"{100 * share:.0f} %"


def listed(words: Sequence[str]) -> str:
    """`a, b and c`."""
    return " and ".join([", ".join(words[:-1]), words[-1]] if len(words) > 1 else words)


def parameter(figure: Parameter) -> str:
    """A parameter with its unit, and its interval where there is one."""
    text = f"{figure.name} {number(figure.value)} {figure.unit}".rstrip()
    return f"{text} ({interval(figure)})" if interval(figure) else text


def interval(figure: Parameter) -> str:
    """A parameter's bounds; empty where it has none."""
    if figure.low is None or figure.high is None:
        return ""
    return f"{number(figure.low)} to {number(figure.high)}"


def key_parameters(effect: FoundEffect) -> str:
    """The parameters of the effect's form that are not 0, then the largest of those that were fitted.

    One whose interval holds 0 comes behind those that are surely not 0. An effect without parameters is
    told by its form.
    """
    if not effect.parameters:
        return effect.form
    of_form = [
        figure for figure in effect.parameters if figure.low is None and abs(figure.value) > _NOTHING
    ]
    fitted = sorted(
        (figure for figure in effect.parameters if figure.low is not None), key=_size, reverse=True
    )
    shown = [*of_form, *fitted][:_MOST_KEY_PARAMETERS]
    more = len(effect.parameters) - len(shown)
    return "; ".join(map(parameter, shown)) + (f"; {more} more" if more else "")


def _size(figure: Parameter) -> tuple[bool, float]:
    # One without bounds is of the form, and certain.
    holds_zero = figure.low is not None and figure.high is not None and figure.low <= 0.0 <= figure.high
    return not holds_zero, abs(figure.value)


def needs(effect: FoundEffect, extras: Iterable[ExtraFeature]) -> str:
    """What the effect takes while the corrected model serves, and who gives it.

    Args:
        extras: what the corrected model takes beside its window.
    """
    if not effect.served:
        # Nobody should set right what held-out blocks speak against.
        doubtful = effect.explained < -HARMFUL
        return f"is only reported{'' if doubtful else f': {why_only_reported(effect.name, effect.form)}'}"
    taken = [extra for extra in extras if extra.name in effect.needs]
    past = [extra.name for extra in taken if not isinstance(extra.history, Elapsed | None)]
    if any(isinstance(extra.history, Elapsed) for extra in taken):
        past.append("the session's time")
    calibrated = any(extra in CALIBRATION_EXTRAS for extra in taken)
    given = [
        f"{extra.name} ({number(extra.default)} where it is not known)"
        for extra in taken
        if extra.history is None and extra not in (*CALIBRATION_EXTRAS, CALIBRATION_AGE)
    ]
    parts = []
    if past:
        parts.append(f"{_shortened(past)}, which the window builder computes from past samples")
    if calibrated:
        parts.append("a calibration, a moment of measurement with the sensor that the model stands for")
    if given:
        parts.append(f"{_shortened(given)}, which the caller gives")
    return f"needs {'; and '.join(parts)}" if parts else "needs nothing beside the window"


def _shortened(words: Sequence[str]) -> str:
    """`a, b and c`, or the first with a count of the others where they are many."""
    if len(words) <= _MOST_NEEDS:
        return listed(words)
    return f"{words[0]} and {len(words) - 1} more"


def minutes(seconds: float) -> str:
    """A duration that a person plans with."""
    return f"{seconds:.0f} s" if seconds < 120 else f"{seconds / 60:.0f} min"
