"""The twin with a planted misalignment, as long as the published recording."""

from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from taxel_models.calibration.calibration import Calibration, calibrate, in_sensor_frame
from taxel_models.calibration.light_contacts import TOUCH_N
from taxel_models.calibration.motion import Motion
from taxel_models.recordings import Recording
from taxel_models.twin import simulate

PAPER_ROWS = 292_200
PLANTED_MM, PLANTED_DEGREES = 5.0, 10.0


@pytest.fixture(scope="module", params=[5, 7])
def twin(request: pytest.FixtureRequest) -> Recording:
    return simulate(PAPER_ROWS, request.param)


@pytest.mark.parametrize("seed", [0, 1])
def test_the_contacts_are_found_again_within_a_fifth_of_a_millimetre(
    twin: Recording, moved: Callable[[Recording, Motion], Recording], seed: int
) -> None:
    dice = np.random.default_rng(seed)
    angle = dice.uniform(0.0, 2.0 * np.pi)
    axis = np.array([0.0, np.cos(angle), np.sin(angle)])
    shift = dice.normal(size=3)
    motion = Motion(
        Rotation.from_rotvec(np.radians(PLANTED_DEGREES) * axis),
        PLANTED_MM * shift / np.linalg.norm(shift),
    )
    recorded = moved(twin, motion)
    found = calibrate([recorded])
    back = in_sensor_frame(recorded, found).samples
    touched = np.linalg.norm(twin.samples.force, axis=1) > TOUCH_N
    off = np.linalg.norm(back.position - twin.samples.position, axis=1)[touched] * 1e3
    assert off.mean() < 0.2
    assert not found.fit.held
    before, after = (np.abs(heights).mean() for heights in (found.fit.before, found.fit.after))
    assert before > 1.0
    assert after == pytest.approx(0.444, abs=0.02)
    turned = np.abs(back.force - twin.samples.force)[touched]
    assert np.quantile(turned / np.linalg.norm(twin.samples.force[touched], axis=1)[:, None], 0.99) < 0.05


def test_the_report_names_what_it_cannot_tell(twin: Recording) -> None:
    found: Calibration = calibrate([twin])
    report = found.report()
    assert list(report["not_identifiable"]) == ["roll"]
    assert report["light_contacts"] == len(found.contacts) > 600
    for part in report["components"].values():
        low, high = part["interval_95"]
        assert low < part["value"] < high
    assert report["nearest_electrode"]["counted"] + report["nearest_electrode"]["off_skin"] == len(
        found.contacts
    )
