"""From contacts to counts: the parts of the twin in physical order."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from taxel.channels import ELECTRODES
from taxel.errors import SettingsError
from taxel_models.recordings.recording import Recording
from taxel_models.twin.constants import JITTER_MM, Constants
from taxel_models.twin.contacts import Contacts, contacts
from taxel_models.twin.converter import NOISE, convert, electrode_noise, one_after_another
from taxel_models.twin.course import course_of
from taxel_models.twin.fluid import (
    counts_of,
    film_log_ratio,
    log_impedance,
    pocketed,
    thickness,
)
from taxel_models.twin.lag import PERIOD_S, lagged
from taxel_models.twin.pressure import static_counts, vibration_counts
from taxel_models.twin.protocol import RecordingProtocol
from taxel_models.twin.skin import STROKE, Skin, dent, fluid_force, sunk_share
from taxel_models.twin.temperature import (
    LOG_IMPEDANCE_PER_KELVIN,
    REFERENCE_C,
    core_celsius,
    core_celsius_between,
    flow_counts,
    tdc_counts,
)

EPOCH_NS: Final = 1_500_000_000_000_000_000
PERIOD_NS: Final = round(PERIOD_S * 1e9)

POSITION_EVERY: Final = 10
"""Rows that hold one tracked position: positions come at 10 Hz (the paper's data set)."""


def simulate(rows: int, seed: int, constants: Constants | None = None) -> Recording:
    """A recording of one finger that is touched many times; the same for the same arguments.

    Time is real: 100 rows are a second, and the finger warms up over an hour. The force acts on the finger.

    Args:
        rows: how many, 10 ms apart.
        seed: seed of every random choice; each part has its own generator.
        constants: of the finger and its rig; those of the paper's data set if none are given.

    Raises:
        SettingsError: `rows` is not positive or `seed` is negative.
    """
    if rows < 1 or seed < 0:
        raise SettingsError(f"rows is {rows} and seed {seed}: expected at least 1 row and a seed from 0")
    generators = np.random.default_rng(seed).spawn(8)
    finger = constants or Constants()
    touch = contacts(rows + 1, finger.sensor.skin_radius, generators[0])
    core = core_celsius(rows + 1, np.minimum(touch.press, 1.0), finger.on_for_s, finger.cooling_k)
    time_ns = PERIOD_NS * np.arange(rows, dtype=np.int64)
    whole = (slice(0, rows + 1),)
    return _recorded(touch, core, whole, time_ns, finger, generators, f"twin-{seed}")


def perform(protocol: RecordingProtocol, seed: int, constants: Constants | None = None) -> Recording:
    """A recording of one finger that is touched as a protocol says; the same for the same arguments.

    A further column of the protocol is a covariate of the recording. The finger does not respond to it.

    Args:
        seed: seed of every random choice; each part has its own generator.
        constants: of the finger and its rig; the protocol says how long the finger is on before.

    Raises:
        SettingsError: `seed` is negative.
    """
    if seed < 0:
        raise SettingsError(f"seed is {seed}: expected at least 0")
    generators = np.random.default_rng(seed).spawn(8)
    finger = constants or Constants()
    course = course_of(protocol, finger.sensor.skin_radius, generators[0])
    touch, rows = course.contacts, course.rows
    lengths = [stretch.stop - stretch.start for stretch in course.stretches]
    touched = np.minimum(touch.press, 1.0)
    core = core_celsius_between(lengths, course.gaps, touched, protocol.on_for_s, finger.cooling_k)
    time_ns = np.rint(course.time_s[:rows] * 1e9).astype(np.int64)
    recording = _recorded(touch, core, course.stretches, time_ns, finger, generators, f"twin-{seed}")
    return replace(recording, covariates=course.columns)


def _recorded(
    touch: Contacts,
    core: NDArray[np.float64],
    stretches: Sequence[slice],
    time_ns: NDArray[np.int64],
    finger: Constants,
    generators: Sequence[np.random.Generator],
    name: str,
) -> Recording:
    """What a finger gives and a rig records.

    Args:
        touch: over n + 1 rows.
        core: (n + 1,) °C.
        stretches: rows without a gap between them, n + 1 in all.
        time_ns: (n,) since the first row.
    """
    _, tracking, cell, texture, noise_levels, noise, grip, pocket = generators
    rows, sensor = len(time_ns), finger.sensor
    skin = Skin.of(sensor)
    squared = skin.squared_distances(touch.places.point)
    sunk = sunk_share(touch.press)
    indented = STROKE * sunk * skin.fluid_near(squared)

    warmer = core - REFERENCE_C
    sunken = lagged(dent(sunk, indented), finger.fluid_lag_s)
    film = thickness(sensor, skin, squared, touch.places.normal, sunken, touch.shear)
    film = pocketed(film, touch.uneven(finger.pocket_spread, pocket))
    impedance = log_impedance(sensor.electrode_rest) + film_log_ratio(film)
    electrodes = one_after_another(counts_of(impedance + LOG_IMPEDANCE_PER_KELVIN * warmer[:, None]))

    load = fluid_force(touch.press) * touch.uneven(finger.carried_spread, grip)
    static = static_counts(load, warmer)
    pac0, pac1 = vibration_counts(static, touch.rubbing, touch.press, texture)
    tdc = tdc_counts(core)
    flow = np.concatenate([flow_counts(tdc[stretch]) for stretch in stretches])

    def read(name: str, counts: NDArray[np.float64]) -> NDArray[np.float64]:
        return convert(counts[:rows], NOISE[name[:3]], noise)

    channels = np.column_stack(
        [
            read("pac0", sensor.rest["pac0"] + pac0),
            read("pdc", sensor.rest["pdc"] + static),
            convert(electrodes, electrode_noise(len(ELECTRODES), noise_levels), noise),
        ]
    )
    return Recording.of(
        EPOCH_NS + time_ns,
        _tracked(touch, indented, finger.tracking_mm, tracking)[:rows] / 1000.0,
        _force(touch, finger.force_noise_n, cell)[:rows],
        channels,
        {
            "pac1": read("pac1", sensor.rest["pac1"] + pac1),
            "tac": read("tac", sensor.rest["tac"] + flow),
            "tdc": read("tdc", tdc),
        },
        name=name,
        format="twin",
    )


def _tracked(
    touch: Contacts, indented: NDArray[np.float64], error_mm: float, tracking: np.random.Generator
) -> NDArray[np.float64]:
    """The tip of the indenter as the tracker reports it, mm: a new position every tenth row."""
    above = (touch.clearance - indented)[:, None]
    offset = error_mm * tracking.standard_normal((int(touch.cycle.max()) + 1, 3))
    true = touch.places.point + above * touch.places.normal
    seen = true + offset[touch.cycle] + JITTER_MM * tracking.standard_normal(true.shape)
    rows = np.arange(len(seen))
    return np.asarray(seen[rows - rows % POSITION_EVERY])


def _force(touch: Contacts, noise_n: float, cell: np.random.Generator) -> NDArray[np.float64]:
    """The force on the finger as the force sensor reports it, N."""
    true = touch.shear - touch.press[:, None] * touch.places.normal
    return np.asarray(true + noise_n * cell.standard_normal(true.shape))
