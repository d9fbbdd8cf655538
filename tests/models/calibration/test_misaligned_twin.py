"""The twin with a known misalignment, as long as the published recording."""

import json

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from taxel_models.calibration.calibration import in_sensor_frame
from taxel_models.calibration.limits import TOUCH_N
from taxel_models.calibration.misaligned_twin import MisalignedTwin, main
from taxel_models.twin.constants import JITTER_MM, TRACKING_MM

HARD = (1, 3, 6)
"""Seeds of the first twelve whose light touches alone are off by more than 0.2 mm."""

FLAT = 45
"""A seed whose contacts tell a standoff from a shift badly: fitted, it is off by 0.12 mm."""


@pytest.fixture(scope="module", params=HARD)
def misaligned(request: pytest.FixtureRequest) -> MisalignedTwin:
    return MisalignedTwin.calibrated(request.param)


def test_the_contacts_are_found_again_within_a_fifth_of_a_millimetre(misaligned: MisalignedTwin) -> None:
    assert misaligned.off_mm < 0.2
    fit = misaligned.found.fit
    assert not fit.held
    assert np.abs(fit.before).mean() > 1.0
    assert np.abs(fit.after).mean() == pytest.approx(0.444, abs=0.02)


def test_a_known_standoff_brings_them_nearer() -> None:
    app = typer.Typer()
    app.command()(main)
    result = CliRunner().invoke(
        app, ["--seed", str(FLAT), "--twins", "1", "--standoff", "0", "--json"], catch_exceptions=False
    )
    told = json.loads(result.stdout)
    assert told["seeds"] == [FLAT]
    assert told["off_mm"][0] < 0.1


def test_forces_are_turned_back(misaligned: MisalignedTwin) -> None:
    true, back = misaligned.twin.samples, in_sensor_frame(misaligned.recorded, misaligned.found).samples
    size = np.linalg.norm(true.force, axis=1)
    turned = np.abs(back.force - true.force) / size[:, None]
    assert np.quantile(turned[size > TOUCH_N], 0.99) < 0.05


def test_the_report_names_what_it_cannot_tell_and_what_it_found(misaligned: MisalignedTwin) -> None:
    found = misaligned.found
    report = found.report()
    assert list(report["not_identifiable"]) == ["roll"]
    assert report["light_contacts"] == len(found.contacts) > 600
    for part in report["components"].values():
        low, high = part["interval_95"]
        assert low < part["value"] < high
    assert report["contacts"] == {
        "indentation_at_1n_mm": found.fit.softness,
        "error_mm": found.fit.contact_error,
        "position_error_mm": found.fit.position_error,
    }
    assert report["nearest_electrode"]["counted"] + report["nearest_electrode"]["off_skin"] == len(
        found.contacts
    )


def test_the_twins_own_spreads_are_found(misaligned: MisalignedTwin) -> None:
    assert misaligned.found.fit.contact_error == pytest.approx(TRACKING_MM, rel=0.1)
    assert misaligned.found.fit.position_error == pytest.approx(JITTER_MM, rel=0.15)
