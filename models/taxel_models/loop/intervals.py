"""The figures of a named effect with their intervals, by leaving out one fold after another."""

import numpy as np
from scipy import stats

from taxel.channels import CHANNELS
from taxel.corrections import Parameter
from taxel_models.loop.attribution import Named


def parameters(named: Named) -> list[Parameter]:
    """The parameters of a form and its weights; weights that all channels have in common once.

    Intervals are 95 % of the jackknife over the cross-validation's folds (Efron and Tibshirani 1993), with
    the quantile of t for so many folds. They are those of the weights without the prior, and count what the
    model's own error leaves open. The value is the weight that was found, which the prior shrinks a little;
    an interval that it would leave reaches to it.
    """
    candidate, folds = named.candidate, named.fold_weights
    found = [
        Parameter(name=name, value=value, unit=unit)
        for name, (value, unit) in candidate.form_parameters.items()
    ]
    if candidate.fitting.fixed:
        return found
    quantile = float(stats.t.ppf(0.975, len(folds) - 1))
    centres = folds.mean(axis=0)
    half_widths = np.hypot(np.sqrt((len(folds) - 1) * folds.var(axis=0)) * quantile, named.unknown)
    names = candidate.weight_names
    units = np.broadcast_to(candidate.weight_units, len(names)).tolist()
    # Electrodes have a weight that all channels share; the pressures may not.
    columns = {"": 2} if candidate.fitting.pooled else {one: CHANNELS.index(one) for one in named.channels}
    for place, (name, unit) in enumerate(zip(names, units, strict=True)):
        for channel, column in columns.items():
            value = named.weights[column, place]
            centre, half_width = centres[column, place], half_widths[column, place]
            source = f"from {candidate.sources[column]}" if candidate.sources else ""
            label = " ".join(filter(None, (name, channel, source)))
            found.append(
                Parameter(
                    name=label,
                    value=float(value),
                    unit=unit,
                    low=float(min(centre - half_width, value)),
                    high=float(max(centre + half_width, value)),
                )
            )
    return found
