"""Offsets and gains that do not change while a contact lasts, and what a material adds."""

import numpy as np

from taxel.channels import CHANNELS
from taxel_models.foreign.injection import ForeignInjection


def offset(injection: ForeignInjection) -> None:
    """Another constant in every channel, as after another taring."""
    change = np.broadcast_to(injection.free_weights(), injection.counts.shape)
    injection.add_whole(change)


def contact_offset(injection: ForeignInjection) -> None:
    """A constant of its own in each contact: the finger seats itself anew."""
    contacts = int(injection.contact.max()) + 1
    drawn = injection.random.standard_normal((contacts, len(CHANNELS))) * injection.deviation
    injection.add(drawn[injection.contact])


def gain(injection: ForeignInjection) -> None:
    """A changed amplifier: every signal is multiplied by nearly the same figure."""
    factors = 1.0 + 0.1 * injection.random.standard_normal(len(CHANNELS))
    injection.add(injection.signal * factors * injection.random.choice([-1.0, 1.0]))


def gain_of_electrodes(injection: ForeignInjection) -> None:
    """Two to four electrodes are more or less sensitive than they were."""
    chosen = injection.electrodes[: int(injection.random.integers(2, 5))]
    change = np.zeros_like(injection.counts)
    share = injection.deviation[chosen] / np.maximum(injection.signal[:, chosen].std(axis=0), 1e-9)
    change[:, chosen] = (
        injection.signal[:, chosen] * share * injection.random.choice([-1.0, 1.0], len(chosen))
    )
    injection.add(change, channels=[CHANNELS[one] for one in chosen])


def material_constant(injection: ForeignInjection) -> None:
    """Each material adds its own constant."""
    kinds, which = np.unique(injection.recording.covariates["material"], return_inverse=True)
    injection.add(
        (injection.random.uniform(-1.0, 1.0, (len(kinds), len(CHANNELS))) * injection.deviation)[which]
    )


def material_gain(injection: ForeignInjection) -> None:
    """Each material has its own sensitivity, alike in all channels."""
    kinds, which = np.unique(injection.recording.covariates["material"], return_inverse=True)
    injection.add(injection.signal * injection.random.uniform(-1.0, 1.0, len(kinds))[which][:, None])
