"""Whether all engines give the same counts: speed is only compared between equal answers."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from taxel.channels import CHANNELS
from taxel.errors import TaxelError
from taxel_bench.engines import Engine
from taxel_bench.peers.peer import reason_of
from taxel_bench.subjects.subject import Subject

Windows = NDArray[np.float32]


@dataclass(frozen=True)
class Agreement:
    """How far the other engines' answers are from ours.

    Attributes:
        differences: the largest of each engine, counts; None where answers are not compared.
        left_out: peers that fail, or whose answers are others, each with the reason.
    """

    differences: dict[str, float | None]
    left_out: dict[str, str]


def compare_answers(subject: Subject, engines: Sequence[Engine], inputs: Sequence[Windows]) -> Agreement:
    """Compare the answers of some engines with ours.

    Args:
        engines: of the subject; our own is passed over.
        inputs: raw windows (n, f) of each call.

    Raises:
        TaxelError: the baseline differs by more than its tolerance: no figure may be printed.
    """
    ours = [subject.taxel.predict(windows) for windows in inputs]
    agreement = Agreement({}, {})
    for engine in engines:
        if engine is subject.taxel:
            continue
        try:
            agreement.differences[engine.name] = _largest_difference(subject, engine, inputs, ours)
        except Exception as error:
            if engine is subject.baseline:
                raise
            agreement.left_out[engine.name] = reason_of(error)
    return agreement


def _largest_difference(
    subject: Subject, engine: Engine, inputs: Sequence[Windows], ours: Sequence[Windows]
) -> float | None:
    theirs = [engine.predict(windows) for windows in inputs]
    if engine.tolerance is None:
        return None
    differences = np.abs(np.concatenate(ours).astype(np.float64) - np.concatenate(theirs))
    allowed = engine.tolerance * np.asarray(subject.manifest.normalisation.output_std)
    if not (differences <= allowed).all():
        largest = int(np.argmax(np.nan_to_num(differences, nan=np.inf)))
        row, column = np.unravel_index(largest, differences.shape)
        raise TaxelError(
            f"{subject.model}: the engine {engine.name} differs from ours by "
            f"{differences[row, column]:g} counts on channel {CHANNELS[column]}: "
            f"expected at most {allowed[column]:g}, so their speed is not compared"
        )
    return float(differences.max())
