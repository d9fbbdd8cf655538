"""Fault: a channel is dead, stuck or intermittent, channels are crossed, or whole frames are repeated."""

from collections.abc import Iterable, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from taxel.channels import CHANNELS, COUNTS_MAX
from taxel.corrections import Fault as FaultTerm
from taxel_models.loop.basis import Floats, Own
from taxel_models.loop.crossed_channels import crossed_since
from taxel_models.loop.effects.effect import Candidate, Effect, Fitting, Online, Remaining
from taxel_models.loop.loose_contacts import loose_contacts
from taxel_models.loop.observations import FEWEST_CONTACTS, Observations, runs
from taxel_models.loop.repeated_frames import held, repeated_frames
from taxel_models.loop.stuck_at import JUMP, WHOLE, Kind, StuckChannel, stuck_channels

CLIPPED: Final = 0.01
"""A channel at a limit of the counts for less than this share of the rows is only clipped."""

LEADS_BEYOND: Final = 0.5
"""Likewise where what its other rows show leads beyond the limit in this share of the rows at it."""

FEWEST_TIMES: Final = 3
"""A channel that keeps a value less often, and in less than 1 % of the rows, is not intermittent."""

FEW_CROSSED: Final = 5
"""A finger that is turned by half a turn exchanges many channels: more are weighed as other effects are."""

_CROSSED: Final = "crossed"
"""How the form of crossed channels begins."""

ROUNDED: Final = 1
"""Counts: a signal that ends at a level is rounded to either side of it."""

BEYOND_END: Final = 0.01
"""With less than this share of the rows beyond a level, it is an end of what a channel shows."""


def _is_cut_off(stuck: StuckChannel, observations: Observations) -> bool:
    """Whether a channel was cut off: at a limit of the counts, or as it saturates."""
    if stuck.value not in (0, COUNTS_MAX):
        return _saturates(stuck, observations)
    if stuck.rows.mean() < CLIPPED:
        return True
    measured, predicted = (
        values[:, stuck.channel] for values in (observations.measured, observations.predicted)
    )
    if _leads_there(measured, predicted, stuck, observations.segment):
        return True
    if stuck.kind == "stuck":
        return False
    others = ~stuck.rows & (measured != stuck.value)
    if others.sum() < 2 or not predicted[others].std() > 0:
        return False
    if _gets_there(measured, stuck.rows, observations.segment):
        return True
    slope, constant = np.polyfit(predicted[others], measured[others], 1)
    scatter = float((measured[others] - slope * predicted[others] - constant).std())
    expected = slope * predicted[stuck.rows] + constant
    within = expected - scatter <= 0 if stuck.value == 0 else expected + scatter >= COUNTS_MAX
    return bool(within.mean() >= LEADS_BEYOND)


def _saturates(stuck: StuckChannel, observations: Observations) -> bool:
    """Whether a channel keeps the end of all that it shows, and gets there and away by usual steps."""
    if stuck.kind == "stuck":
        return False
    measured = observations.measured[:, stuck.channel]
    away = measured - stuck.value
    if (away > ROUNDED).mean() >= BEYOND_END and (away < -ROUNDED).mean() >= BEYOND_END:
        return False
    # Rows that are taken for absences were chosen by their jumps: all rows at the end tell, too.
    at_end = stuck.rows | (np.abs(away) <= ROUNDED)
    return any(
        _edges(rows, observations.segment).any() and _gets_there(measured, rows, observations.segment)
        for rows in (stuck.rows, at_end)
    )


def _leads_there(
    measured: Floats, predicted: Floats, stuck: StuckChannel, segment: NDArray[np.int64]
) -> bool:
    """Whether the prediction leads to the limit, with what the channel (n,) showed just before or after."""
    residual, free = measured - predicted, ~stuck.rows
    own = np.flatnonzero(free)
    if not len(own):
        return False
    rows = np.flatnonzero(stuck.rows)
    after = np.searchsorted(own, rows)
    before, after = own[np.maximum(after - 1, 0)], own[np.minimum(after, len(own) - 1)]
    # Segments that are at the limit as a whole go by the nearest rows of others.
    apart = [
        np.abs(rows - other) + len(measured) * (segment[rows] != segment[other])
        for other in (before, after)
    ]
    nearest = np.where(apart[0] <= apart[1], before, after)
    there = predicted[rows] + residual[nearest]
    scatter = [float(residual[part][free[part]].std()) for part in runs(segment) if free[part].any()]
    most = float(np.median(scatter))
    within = there - most <= 0 if stuck.value == 0 else there + most >= COUNTS_MAX
    return bool(within.mean() >= LEADS_BEYOND)


def _gets_there(measured: Floats, stuck: NDArray[np.bool_], segment: NDArray[np.int64]) -> bool:
    """Whether a channel (n,) comes to its limit and leaves it by usual steps: a loose contact jumps.

    A channel that is at its limit for whole segments shows no jump.
    """
    steps, edges = np.abs(np.diff(measured)), _edges(stuck, segment)
    free = (np.diff(segment) == 0) & ~stuck[1:] & ~stuck[:-1]
    return bool(not edges.any() or np.median(steps[edges]) <= JUMP * max(float(steps[free].mean()), 1.0))


def _edges(stuck: NDArray[np.bool_], segment: NDArray[np.int64]) -> NDArray[np.bool_]:
    """(n - 1,) whether a channel comes to its value or leaves it from a row to the next."""
    return np.asarray((np.diff(segment) == 0) & (stuck[1:] != stuck[:-1]))


def _errs_elsewhere(stuck: StuckChannel, residual: Floats) -> bool:
    """Whether a channel that comes and goes errs as much in its other rows: its signal is weak."""
    own = residual[:, stuck.channel] ** 2
    return bool(stuck.kind == "intermittent" and own[stuck.rows].mean() <= own[~stuck.rows].mean())


def _is_foretold(stuck: StuckChannel, residual: Floats) -> bool:
    """Whether the model says what a channel keeps, which it kept in training, too."""
    return bool(np.abs(residual[stuck.rows, stuck.channel]).max() <= ROUNDED)


def _hardly_ever(stuck: StuckChannel) -> bool:
    """Whether a channel keeps its value once or twice for a moment: one press can do that."""
    times = np.count_nonzero(np.diff(stuck.rows.astype(np.int8), prepend=0) > 0)
    seldom = stuck.rows.mean() < CLIPPED and times < FEWEST_TIMES
    return bool(stuck.kind == "intermittent" and seldom)


def _both_sides_tell(contact: NDArray[np.int64], since: int) -> bool:
    """Whether enough contacts lie on both sides of a row: by chance, few show any order of the channels."""
    return not since or all(
        len(np.unique(side)) >= FEWEST_CONTACTS for side in (contact[:since], contact[since:])
    )


def is_crossed(form: str) -> bool:
    """Whether a form of a fault says that channels are crossed."""
    return form.startswith(_CROSSED)


class Fault(Effect):
    """A channel keeps a value: always, from some time on, or off and on.

    Or channels hold each other's signals, or all channels repeat frames.
    """

    name = "fault"
    looks_at_residual = True
    equation = (
        "measured_c = v_c; for crossed channels, what the model says of another one; for repeated frames, "
        "the model at the last frame that came"
    )
    source = "stuck channels and unconnected fingers in public logs"
    signature = (
        "one value for longer than chance allows, reached by a jump or kept while the prediction moves; "
        "or jumps to one level and back, again and again; or each of two channels follows the other's "
        "prediction; or all electrodes repeat their counts at once"
    )

    @override
    def forms(self, observations: Observations, remaining: Remaining) -> Iterable[Candidate]:
        seen = observations.measured, observations.predicted, observations.segment
        loose = [each for each in loose_contacts(*seen) if not _is_cut_off(each, observations)]
        others = [
            stuck
            for stuck in stuck_channels(*seen)
            if stuck.channel not in {each.channel for each in loose}
            and not _is_cut_off(stuck, observations)
            and not _errs_elsewhere(stuck, observations.residual)
            and not _hardly_ever(stuck)
            and not _is_foretold(stuck, observations.residual)
        ]
        kinds: tuple[Kind, ...] = ("stuck", "intermittent")
        for kind in kinds:
            some = [stuck for stuck in (*others, *loose) if stuck.kind == kind]
            if some:
                yield self._with(some, kind, remaining.residual, observations)
        crossed, since = crossed_since(observations.measured, observations.predicted)
        if (crossed != np.arange(len(CHANNELS))).any() and _both_sides_tell(observations.contact, since):
            yield self._crossed(crossed, since, observations)
        repeated = repeated_frames(observations)
        if repeated.any():
            yield self._repeating(repeated, observations)

    @override
    @classmethod
    def why_only_reported(cls, form: str) -> str:
        if is_crossed(form):
            return "put the channels in their order where they are read, or in the recording"
        if form.startswith("stuck"):
            return "the channel worked before that; mend it, or leave out what was recorded since"
        return super().why_only_reported(form)

    def _crossed(self, holds: NDArray[np.int64], since: int, observations: Observations) -> Candidate:
        """It is only reported: what is wrong is the order of the channels, which belongs in no model.

        Args:
            since: the first row; 0 where they were crossed all the time.
        """
        change = observations.predicted[:, holds] - observations.predicted
        change[:since] = 0.0
        when = f", from {observations.time_s[since]:.0f} s on" if since else ""
        pairs = [
            f"{name} holds {CHANNELS[other]}"
            for name, other in zip(CHANNELS, holds, strict=True)
            if name != CHANNELS[other]
        ]
        return Candidate(
            self.name,
            f"{_CROSSED}: {', '.join(pairs)}{when}",
            Own(change[:, :, None].astype(np.float32)),
            fitting=Fitting(fixed=True, beforehand=len(pairs)),
            certain=len(pairs) <= FEW_CROSSED,
            ages=since > 0,
            again=lambda other: self._crossed(holds, since, other),
        )

    def _repeating(self, repeated: NDArray[np.bool_], observations: Observations) -> Candidate:
        change = held(observations.predicted, repeated) - observations.predicted
        return Candidate(
            self.name,
            "repeated frames",
            Own(change[:, :, None].astype(np.float32)),
            fitting=Fitting(fixed=True),
            form_parameters={"rows affected": (float(repeated.mean()), "share")},
            certain=True,
            again=lambda other: self._repeating(repeated, other),
        )

    def _with(
        self, found: Sequence[StuckChannel], kind: Kind, residual: Floats, observations: Observations
    ) -> Candidate:
        values = np.zeros((*residual.shape, 1), np.float32)
        names, served = [], []
        for stuck in found:
            values[stuck.rows, stuck.channel, 0] = residual[stuck.rows, stuck.channel]
            name, share = CHANNELS[stuck.channel], float(stuck.rows.mean())
            if kind == "stuck":
                since = observations.time_s[int(np.argmax(stuck.rows))]
                when = "" if share >= WHOLE else f" from {since:.0f} s on"
                names.append(f"{name} at {stuck.value:.0f}{when}")
                if not when:
                    served.append(FaultTerm(channel=name, value=stuck.value))
            else:
                names.append(name)
        online = Online(tuple(served))
        return Candidate(
            self.name,
            f"{kind}: {', '.join(names)}",
            Own(values),
            fitting=Fitting(fixed=True),
            form_parameters={
                f"rows affected, {CHANNELS[stuck.channel]}": (float(stuck.rows.mean()), "share")
                for stuck in found
            },
            online=lambda _: online,
            certain=True,
            again=lambda _: self._with(found, kind, residual, observations),
        )
