"""A calibration: the placement of recordings in the sensor's frame, and its uncertainty."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from taxel import __version__
from taxel_models.calibration.fit import RESAMPLES, STARTS, Fit, fit
from taxel_models.calibration.light_contacts import ORIENTATION, LightContacts
from taxel_models.calibration.limits import Limits
from taxel_models.calibration.motion import ANGLES, STANDOFF
from taxel_models.calibration.nearest import NearestElectrodes
from taxel_models.recordings import Recording
from taxel_models.twin.sensor import Sensor

ROLL: Final = "the skin is a surface of revolution about x: turning about it changes no distance"
HELD: Final = "the contacts do not determine it: held at 0"


@dataclass(frozen=True)
class Calibration:
    """What was estimated from the light contacts of recordings in one frame.

    Attributes:
        contacts: as recorded.
        limits: by which they were found.
        fit: the placement.
        placed: (n, 3), the light contacts' points in the sensor's frame, mm.
        nearest: the electrodes nearest to where the contacts began.
        seed: seed of the fit.
        sources: name, rows and sha256 of each recording.
    """

    contacts: LightContacts
    limits: Limits
    fit: Fit
    placed: NDArray[np.float64]
    nearest: NearestElectrodes
    seed: int
    sources: tuple[dict[str, Any], ...]

    def report(self) -> dict[str, Any]:
        """For JSON; lengths in mm, angles in degrees."""
        motion = self.fit.placement.motion
        fitted_standoff = STANDOFF[0] in self.fit.names
        probe = (
            {"standoff_mm": self.fit.placement.standoff}
            if fitted_standoff
            else {"offset_mm": self.fit.placement.offset.tolist()}
        )
        return {
            "taxel_version": __version__,
            "recordings": list(self.sources),
            "light_contacts": len(self.contacts),
            "limits_n": {"touch": self.limits.touch, "light": self.limits.light},
            "distance_mm": {"before": distances(self.fit.before), "after": distances(self.fit.after)},
            "sensor": {
                "translation_mm": motion.translation.tolist(),
                "quaternion_xyzw": motion.rotation.as_quat(canonical=True).tolist(),
                "rotation_deg": float(np.degrees(motion.rotation.magnitude())),
            },
            "probe": probe,
            "contacts": {
                "indentation_at_1n_mm": self.fit.softness,
                "error_mm": self.fit.contact_error,
                "position_error_mm": self.fit.position_error,
            },
            "centre_mm": self.fit.placement.centre.tolist(),
            "components": self._components(),
            "not_identifiable": {"roll": ROLL, **dict.fromkeys(self.fit.held, HELD)},
            "optimiser": {
                "seed": self.seed,
                "starts": STARTS + 1,
                "agreeing_starts": self.fit.agreeing,
                "resamples": RESAMPLES,
            },
            "nearest_electrode": self.nearest.report(),
        }

    def _components(self) -> dict[str, Any]:
        """Each component. Fitted ones have a standard error and a 95 % interval."""
        found: dict[str, Any] = {}
        columns = zip(self.fit.names, self.fit.placement.values, self.fit.resampled.T, strict=True)
        for name, value, resampled in columns:
            unit, scale = ("deg", 180.0 / np.pi) if name in ANGLES else ("mm", 1.0)
            if name in self.fit.held:
                found[name] = {"status": "not identifiable", "unit": unit}
                continue
            found[name] = {"status": "given", "unit": unit, "value": float(value * scale)}
            if name not in self.fit.given:
                low, high = np.quantile(resampled, [0.025, 0.975]) * scale
                found[name] |= {
                    "status": "fitted",
                    "standard_error": float(resampled.std(ddof=1) * scale),
                    "interval_95": [float(low), float(high)],
                }
        return found


def calibrate(
    recordings: Sequence[Recording],
    *,
    limits: Limits | None = None,
    standoff: float | None = None,
    seed: int = 0,
) -> Calibration:
    """Estimate where the sensor is in the frame that recordings share.

    Args:
        limits: forces that define a light contact; the defaults of `Limits` if not given.
        standoff: distance of the tracked point from the skin as it just touches, mm; fitted if not given.

    Raises:
        RecordingError: there are too few light contacts, or all are in one place.
        SettingsError: a standoff is given where the probe's offset is fitted.
    """
    limits = limits or Limits()
    sensor = Sensor.biotac_2p()
    contacts = LightContacts.of(recordings, limits)
    found = fit(contacts, sensor.skin_radius, seed, standoff)
    placement = found.placement
    began = placement.placed(contacts.first, contacts.first_orientation)
    return Calibration(
        contacts=contacts,
        limits=limits,
        fit=found,
        placed=placement.placed(contacts.position, contacts.orientation),
        nearest=NearestElectrodes.of(began, sensor),
        seed=seed,
        sources=tuple(
            {"name": each.name, "rows": len(each), "sha256": each.fingerprint} for each in recordings
        ),
    )


def in_sensor_frame(recording: Recording, calibration: Calibration) -> Recording:
    """A recording with its positions and forces in the sensor's frame.

    The tracked point becomes the contact point only if the probe's offset is known. The standoff is not
    subtracted, because it has no meaning away from the skin.
    """
    placement, samples = calibration.fit.placement, recording.samples
    orientation = None
    if calibration.contacts.orientation is not None:
        orientation = np.column_stack([recording.covariates[name] for name in ORIENTATION])
    moved = replace(
        samples,
        position=placement.placed(samples.position * 1e3, orientation) / 1e3,
        force=placement.motion.turn(samples.force),
    )
    kept = {name: column for name, column in recording.covariates.items() if name not in ORIENTATION}
    return replace(recording, samples=moved, covariates=kept, sha256="")


def distances(heights: NDArray[np.float64]) -> dict[str, float]:
    """Mean, median and root mean square of distances from the skin."""
    size = np.abs(heights)
    return {
        "mean": float(size.mean()),
        "median": float(np.median(size)),
        "rms": float(np.sqrt((size**2).mean())),
    }
