"""Whether both engines give the same counts: speed is only compared between equal answers."""

import numpy as np
from numpy.typing import NDArray

from taxel.channels import CHANNELS
from taxel.errors import TaxelError
from taxel_bench.subjects import Subject


def largest_difference(subject: Subject, windows: NDArray[np.float32]) -> float | None:
    """Largest difference between the engines' counts; None where values are not to be compared.

    Args:
        windows: (n, f) raw; all are evaluated in one call.

    Raises:
        TaxelError: the engines differ by more than the subject's tolerance: no figure may be printed.
    """
    if subject.peer is None or subject.tolerance is None:
        return None
    found = subject.taxel.predict(windows).astype(np.float64)
    differences = np.abs(found - subject.peer.predict(windows))
    allowed = subject.tolerance * np.asarray(subject.manifest.normalisation.output_std)
    if not (differences <= allowed).all():
        row, column = np.unravel_index(int(np.argmax(np.nan_to_num(differences, nan=np.inf))), found.shape)
        raise TaxelError(
            f"{subject.model}: the engines differ by {differences[row, column]:g} counts on channel "
            f"{CHANNELS[column]}: expected at most {allowed[column]:g}, so their speed is not compared"
        )
    return float(differences.max())
