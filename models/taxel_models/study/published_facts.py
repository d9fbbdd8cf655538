"""The twin beside the published data set: `python -m taxel_models.study.published_facts` prints the table.

Each published fact has a range, and the twin's figure is in it or not. Facts about the recording come from
a new twin. Facts about errors come from the manifest of a Network B that was trained on a twin, by default
the shipped one. If the paper shows a fact only as a picture, the comparison is qualitative.
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any, Final

import numpy as np
import typer
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table
from scipy import stats

from taxel.artifacts import folder_of, read
from taxel.channels import CHANNELS, ELECTRODE_COLUMNS
from taxel.commands.cli import Json, failing_clearly, print_json
from taxel.errors import SettingsError
from taxel.skin import height_above_skin
from taxel_models.calibration.light_contacts import LightContacts
from taxel_models.calibration.limits import Limits
from taxel_models.calibration.nearest import NearestElectrodes
from taxel_models.recordings import Recording
from taxel_models.shipped import shipped_repository
from taxel_models.study.published import ROWS, published_result, published_temperature
from taxel_models.twin import simulate
from taxel_models.twin.sensor import Sensor
from taxel_models.twin.summary import TOUCHED_N, summarise
from taxel_models.twin.temperature import END_COUNTS, MEAN_COUNTS, START_COUNTS

LIGHT_CONTACTS_MM: Final = 0.444
"""Mean distance of the paper's light contacts from the skin after calibration."""

TIP: Final = ("e7", "e8", "e9", "e10")
"""The electrodes with the highest normalised errors in the paper's box plots, which have no numbers."""

UNEVEN_P: Final = 0.001
"""Contacts are uneven if an even distribution over the electrodes would be less likely than this."""

MINUTE: Final = 6000
"""Rows."""


@dataclass(frozen=True)
class Fact:
    """A published fact, and the twin's figure.

    Attributes:
        published: the figure, or a description in words.
        low: the least value that meets the fact; None if there is no lower limit.
        high: the largest such value; None if there is no upper limit.
        twin: the twin's figure.
    """

    name: str
    published: float | str
    low: float | None
    high: float | None
    twin: float

    @property
    def met(self) -> bool:
        """Whether the twin lies in the range."""
        return (self.low is None or self.low <= self.twin) and (self.high is None or self.twin <= self.high)


def within(name: str, published: float, tolerance: float, twin: float) -> Fact:
    """A fact with a published number."""
    return Fact(name, published, published - tolerance, published + tolerance, twin)


def recording_facts(recording: Recording) -> list[Fact]:
    """Facts about a twin's recording.

    Raises:
        RecordingError: it is too short to have light contacts.
    """
    tdc = recording.auxiliary["tdc"]
    naive = summarise(recording)["mean_predictor_norm_mae"]
    return [
        within(
            "normalised MAE of the mean predictor", published_temperature()["mean_predictor"], 0.03, naive
        ),
        within("tdc, mean of the first second", START_COUNTS, 5, float(tdc[:100].mean())),
        within("tdc, mean", MEAN_COUNTS, 5, float(tdc.mean())),
        within("tdc, mean of the last second", END_COUNTS, 5, float(tdc[-100:].mean())),
        Fact("share of minutes over which tdc rises", "rises throughout", 0.95, None, _rising_share(tdc)),
        *_rest_facts(recording),
        *_contact_facts(recording),
    ]


def _rising_share(tdc: NDArray[np.float64]) -> float:
    """The share of minutes whose mean is above the mean of the minute before."""
    minutes = len(tdc) // MINUTE
    if minutes < 2:
        raise SettingsError(f"{len(tdc)} rows: expected two minutes, {2 * MINUTE}")
    return float((np.diff(tdc[: minutes * MINUTE].reshape(minutes, MINUTE).mean(axis=1)) > 0).mean())


def _rest_facts(recording: Recording) -> list[Fact]:
    """Medians of untouched rows against the published resting counts."""
    sensor = Sensor.biotac_2p()
    untouched = np.linalg.norm(recording.samples.force, axis=1) < TOUCHED_N
    rest = np.median(recording.channels[untouched], axis=0)
    found = {"pac0": rest[0], "pdc": rest[1], "tac": np.median(recording.auxiliary["tac"][untouched])}
    largest = np.abs(rest[ELECTRODE_COLUMNS] - sensor.electrode_rest).max()
    return [
        *(
            within(f"{name} at rest, counts", sensor.rest[name], 10, float(value))
            for name, value in found.items()
        ),
        Fact("electrodes at rest, largest difference, counts", 0.0, None, 10, float(largest)),
    ]


def _contact_facts(recording: Recording) -> list[Fact]:
    sensor = Sensor.biotac_2p()
    light = LightContacts.of([recording], Limits())
    distance = np.abs(height_above_skin(light.position, sensor.skin_radius)).mean()
    nearest = NearestElectrodes.of(light.first, sensor).contacts
    chance = float(stats.chisquare(nearest).pvalue)
    return [
        within("distance of light contacts from the skin, mm", LIGHT_CONTACTS_MM, 0.05, float(distance)),
        Fact("contacts by nearest electrode, p if even", "uneven (figure)", None, UNEVEN_P, chance),
    ]


def model_facts(metrics: Mapping[str, Any]) -> list[Fact]:
    """Facts about the errors of a Network B, inputs 1.

    Args:
        metrics: held-out errors, as in the manifest of one trained with the temperature.

    Raises:
        SettingsError: it was trained without.
    """
    if not {"test_measured_temperature", "test_mean_temperature"} <= set(metrics):
        raise SettingsError("its manifest lacks the errors with measured and mean temperature")
    paper = published_temperature()
    known, fixed = metrics["test_measured_temperature"], metrics["test_mean_temperature"]
    loss = (fixed["norm_mae"] - known["norm_mae"]) / metrics["mean_predictor"]["norm_mae"]
    return [
        within("normalised MAE, temperature measured", paper["measured"], 0.03, known["norm_mae"]),
        within("normalised MAE, temperature at its mean", paper["mean"], 0.03, fixed["norm_mae"]),
        within("relative loss of fixing the temperature", paper["relative_loss"], 0.05, loss),
        *_tip_facts({name: figures["norm_mae"] for name, figures in fixed["per_channel"].items()}),
        *_fluid_facts(fixed),
    ]


def _tip_facts(errors: Mapping[str, float]) -> list[Fact]:
    hardest = sorted(CHANNELS, key=lambda name: errors[name])[-len(TIP) :]
    tip, others = (
        float(np.mean([errors[name] for name in CHANNELS[ELECTRODE_COLUMNS] if (name in TIP) is at_tip]))
        for at_tip in (True, False)
    )
    return [
        Fact(
            "e7 to e10 among the four hardest channels", "4 (figure)", 4, None, len(set(TIP) & set(hardest))
        ),
        Fact("error of e7 to e10 over that of the other electrodes", "above 1", 1, None, tip / others),
    ]


def _fluid_facts(ours: Mapping[str, float]) -> list[Fact]:
    """Mean error of pac0 and pdc over that of the electrodes, from the means over 21 and over 19."""
    theirs = published_result("network-b", 1)
    assert theirs is not None
    return [
        within(
            f"{label} of pac0 and pdc over the electrodes'", paper, 0.25 * paper, _fluid_ratio(ours, key)
        )
        for key, label in (("mae", "MAE"), ("norm_mae", "normalised MAE"))
        for paper in [_fluid_ratio(theirs, key)]
    ]


def _fluid_ratio(errors: Mapping[str, Any], metric: str) -> float:
    electrodes = len(CHANNELS[ELECTRODE_COLUMNS])
    fluid = len(CHANNELS) * errors[metric] - electrodes * errors[f"{metric}_electrodes"]
    return float(fluid / (len(CHANNELS) - electrodes) / errors[f"{metric}_electrodes"])


def table(facts: list[Fact]) -> Table:
    """One row for each fact."""
    lines = Table("fact", "published", "met if", "twin", "met")
    for fact in facts:
        published = fact.published if isinstance(fact.published, str) else f"{fact.published:.4g}"
        lines.add_row(fact.name, published, _range(fact), f"{fact.twin:.4g}", "yes" if fact.met else "no")
    return lines


def _range(fact: Fact) -> str:
    if fact.low is None:
        return f"at most {fact.high:.4g}"
    if fact.high is None:
        return f"at least {fact.low:.4g}"
    return f"{fact.low:.4g} to {fact.high:.4g}"


def main(
    rows: Annotated[int, typer.Option(min=2 * MINUTE, help="Of the twin.")] = ROWS,
    seed: Annotated[int, typer.Option(min=0, help="Of the twin.")] = 7,
    model: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER", help="An artifact of a Network B trained on a twin; else the shipped one."
        ),
    ] = None,
    as_json: Json = False,
) -> None:
    """Print the twin beside the published data set."""
    folder = model or folder_of(shipped_repository(), "network-b")
    training = read(folder).manifest.training
    if training is None or training.family != "network-b":
        raise SettingsError(f"{folder}: expected a Network B that was trained here")
    facts = [*recording_facts(simulate(rows, seed)), *model_facts(training.metrics)]
    if as_json:
        print_json(
            {
                "rows": rows,
                "seed": seed,
                "model_rows": [source.rows for source in training.data],
                "facts": [{**asdict(fact), "met": fact.met} for fact in facts],
            }
        )
        return
    Console().print(table(facts))


if __name__ == "__main__":
    typer.run(failing_clearly(main))
