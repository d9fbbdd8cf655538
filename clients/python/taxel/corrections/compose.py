"""The only place where terms are summed, kept within limits, and faulty channels are replaced."""

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from taxel.channels import CHANNELS
from taxel.corrections.count_limits import CountLimits
from taxel.corrections.effect import Term
from taxel.corrections.fault import Fault
from taxel.corrections.term import Columns


class Composition:
    """The terms of a correction, ready to be added: counts = start + Σ delta(p), then limits, then faults.

    Args:
        terms: in the order of the effects. Only the order of faults on one channel matters.
    """

    def __init__(self, terms: Iterable[Term]) -> None:
        everything = tuple(terms)
        self._added = [term for term in everything if not isinstance(term, CountLimits | Fault)]
        self._low, self._high = np.full(len(CHANNELS), -np.inf), np.full(len(CHANNELS), np.inf)
        for term in everything:
            if isinstance(term, CountLimits):
                self._low[term.columns] = np.maximum(self._low[term.columns], term.low)
                self._high[term.columns] = np.minimum(self._high[term.columns], term.high)
        self._limited = bool(np.isfinite(self._low).any())
        self._faults = [term for term in everything if isinstance(term, Fault)]

    def counts(
        self, p: NDArray[np.float64], columns: Columns, start: NDArray[np.float64] | None = None
    ) -> NDArray[np.float64]:
        """Corrected counts.

        Args:
            p: (n, 21), the base model's prediction, counts; every term is computed from it.
            columns: at least the features that the terms take.
            start: (n, 21), counts that the terms are added to, where these are not p: the
                prediction of a model that is corrected already.

        Returns:
            (n, 21), counts; a new array.
        """
        counts = (p if start is None else start).copy()
        for term in self._added:
            counts += term.delta(p, columns)
        if self._limited:
            np.clip(counts, self._low, self._high, out=counts)
        for fault in self._faults:
            counts[:, fault.column] = fault.value
        return counts
