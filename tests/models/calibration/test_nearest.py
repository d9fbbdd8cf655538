"""Contacts by nearest electrode."""

import numpy as np

from taxel.channels import ELECTRODES
from taxel_models.calibration.nearest import NearestElectrodes
from taxel_models.twin.sensor import Sensor
from taxel_models.twin.skin import Skin


def test_each_contact_counts_for_the_electrode_under_it() -> None:
    sensor = Sensor.biotac_2p()
    feet = Skin.of(sensor).feet
    points = np.repeat(feet, np.arange(1, 20), axis=0)
    found = NearestElectrodes.of(points, sensor)
    np.testing.assert_array_equal(found.contacts, np.arange(1, 20))
    assert found.off_skin == 0
    assert found.report()["contacts"] == dict(zip(ELECTRODES, range(1, 20), strict=True))


def test_what_is_off_the_skin_is_told_apart() -> None:
    sensor = Sensor.biotac_2p()
    points = np.array([[-5.0, 0.0, -7.0], [-5.0, 0.0, -9.5], [-5.0, 0.0, -1.0]])
    found = NearestElectrodes.of(points, sensor)
    assert found.contacts.sum() == 1
    assert found.off_skin == 2
