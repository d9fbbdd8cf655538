"""Recording protocols: what to do with a finger, step by step, so that a recording shows what is asked.

A protocol is a JSON document. `taxel_models.twin.perform` carries it out on the twin, a person on a real
finger.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Final, Literal, Self

from pydantic import Field, ValidationError, model_validator

from taxel.errors import SettingsError
from taxel.schema import Positive, Schema

TRAVEL_S: Final = 0.5
APPROACH_S: Final = 0.3
"""How long the indenter moves to a place, and down to the skin or up again."""

LONGEST_S: Final = 3600.0
"""Of what is recorded."""

_MOST_REPEATS: Final = 1000


class Place(Schema):
    """A place on the skin.

    Attributes:
        along_mm: arc length from the seam between body and round tip, positive towards the tip.
        around_deg: angle about the long axis, 0 at the underside.
    """

    along_mm: Annotated[float, Field(ge=-14.0, le=10.0)]
    around_deg: Annotated[float, Field(ge=-115.0, le=115.0)]


class Press(Schema):
    """A press at a place: load, hold, release.

    Attributes:
        force_n: normal force that is held.
        speed_n_s: mean speed of loading and of releasing, N/s.
        hold_s: how long the force is held.
        shear: tangential force over normal force, towards the tip and sideways.
    """

    kind: Literal["press"] = "press"
    place: Place
    force_n: Annotated[float, Field(gt=0, le=10.0)]
    speed_n_s: Positive = 5.0
    hold_s: Annotated[float, Field(ge=0, le=600.0)] = 1.0
    shear: tuple[Annotated[float, Field(ge=-0.6, le=0.6)], Annotated[float, Field(ge=-0.6, le=0.6)]] = (
        0.0,
        0.0,
    )

    @property
    def seconds(self) -> float:
        """With the way there and back."""
        return TRAVEL_S + 2 * APPROACH_S + 2 * self.force_n / self.speed_n_s + self.hold_s


class Pause(Schema):
    """Nothing touches the finger; it is recorded."""

    kind: Literal["pause"] = "pause"
    seconds: Annotated[float, Field(gt=0, le=LONGEST_S)]


class WarmUp(Schema):
    """The finger is on and nothing touches it; it is not recorded."""

    kind: Literal["warm_up"] = "warm_up"
    seconds: Positive


class SwitchOff(Schema):
    """The finger is off and cools; it is not recorded."""

    kind: Literal["switch_off"] = "switch_off"
    seconds: Positive


class Turn(Schema):
    """The finger is turned about its long axis: later presses meet another side of it."""

    kind: Literal["turn"] = "turn"
    degrees: Annotated[float, Field(ge=-180.0, le=180.0)]


class Column(Schema):
    """From here on, a further column of the recording, such as `material`, has this value."""

    kind: Literal["column"] = "column"
    column: Annotated[str, Field(min_length=1)]
    value: Annotated[float, Field(allow_inf_nan=False)]


Step = Annotated[Press | Pause | WarmUp | SwitchOff | Turn | Column, Field(discriminator="kind")]


class RecordingProtocol(Schema):
    """What to record.

    Attributes:
        name: a few words.
        about: what to do, in a sentence or two.
        on_for_s: how long the finger is on before the first step.
        repeat: how often the steps are done, one round after another.
        steps: of a round.
    """

    name: Annotated[str, Field(min_length=1)]
    about: str = ""
    on_for_s: Annotated[float, Field(ge=0, allow_inf_nan=False)] = 1200.0
    repeat: Annotated[int, Field(ge=1, le=_MOST_REPEATS)] = 1
    steps: Annotated[tuple[Step, ...], Field(min_length=1)]

    @model_validator(mode="after")
    def _is_short_enough(self) -> Self:
        if not 0 < self.recorded_s <= LONGEST_S:
            raise ValueError(
                f"{self.recorded_s:g} s are recorded: expected above 0 and at most {LONGEST_S:g} s"
            )
        return self

    def all_steps(self) -> Iterator[Step]:
        """Of all rounds."""
        for _ in range(self.repeat):
            yield from self.steps

    @property
    def recorded_s(self) -> float:
        """Length of the recording without its gaps, s."""
        return self.repeat * sum(step.seconds for step in self.steps if isinstance(step, (Press, Pause)))

    @property
    def duration_s(self) -> float:
        """How long all steps take, s."""
        unrecorded = sum(step.seconds for step in self.steps if isinstance(step, (WarmUp, SwitchOff)))
        return self.recorded_s + self.repeat * unrecorded


def read_protocol(path: Path) -> RecordingProtocol:
    """A protocol from a JSON file.

    Raises:
        SettingsError: the file cannot be read, or is not a protocol.
    """
    try:
        return RecordingProtocol.model_validate_json(path.read_bytes())
    except OSError as error:
        raise SettingsError(f"{path}: {error.strerror}") from None
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"])) or "the document"
        raise SettingsError(f"{path}: {where}: {first['msg']}") from None
