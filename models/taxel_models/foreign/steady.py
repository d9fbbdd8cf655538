"""Offsets and gains that do not change while a contact lasts, and what a material adds."""

import numpy as np

from taxel.channels import CHANNELS
from taxel_models.foreign.planting import Planting


def offset(planting: Planting) -> None:
    """Another constant in every channel, as after another taring."""
    change = np.broadcast_to(planting.free_weights(), planting.counts.shape)
    planting.add_whole(change)


def contact_offset(planting: Planting) -> None:
    """A constant of its own in each contact: the finger seats itself anew."""
    contacts = int(planting.contact.max()) + 1
    drawn = planting.random.standard_normal((contacts, len(CHANNELS))) * planting.deviation
    planting.add(drawn[planting.contact])


def gain(planting: Planting) -> None:
    """A changed amplifier: every signal is multiplied by nearly the same figure."""
    factors = 1.0 + 0.1 * planting.random.standard_normal(len(CHANNELS))
    planting.add(planting.signal * factors * planting.random.choice([-1.0, 1.0]))


def gain_of_electrodes(planting: Planting) -> None:
    """Two to four electrodes are more or less sensitive than they were."""
    chosen = planting.electrodes[: int(planting.random.integers(2, 5))]
    change = np.zeros_like(planting.counts)
    share = planting.deviation[chosen] / np.maximum(planting.signal[:, chosen].std(axis=0), 1e-9)
    change[:, chosen] = (
        planting.signal[:, chosen] * share * planting.random.choice([-1.0, 1.0], len(chosen))
    )
    planting.add(change, channels=[CHANNELS[one] for one in chosen])


def material_constant(planting: Planting) -> None:
    """Each material adds its own constant."""
    kinds, which = np.unique(planting.recording.covariates["material"], return_inverse=True)
    planting.add(
        (planting.random.uniform(-1.0, 1.0, (len(kinds), len(CHANNELS))) * planting.deviation)[which]
    )


def material_gain(planting: Planting) -> None:
    """Each material has its own sensitivity, alike in all channels."""
    kinds, which = np.unique(planting.recording.covariates["material"], return_inverse=True)
    planting.add(planting.signal * planting.random.uniform(-1.0, 1.0, len(kinds))[which][:, None])
