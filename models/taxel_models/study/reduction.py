"""A reduced scale: fewer rows, by whole trials, chunks or sessions."""

from collections.abc import Sequence

import numpy as np

from taxel.errors import SettingsError
from taxel_models.recordings import Recording
from taxel_models.training.split import Grouping, groups_of


def reduce_rows(
    recordings: Sequence[Recording], grouping: Grouping, rows: int | None, seed: int
) -> list[Recording]:
    """Keep randomly drawn whole groups, in their order, until they have at least `rows` rows.

    Args:
        rows: None keeps everything.

    Raises:
        SettingsError: there are not so many rows.
    """
    if rows is None:
        return list(recordings)
    total = sum(map(len, recordings))
    if not 0 < rows <= total:
        raise SettingsError(f"--rows {rows}: expected 1 to {total}, the rows there are")
    groups = groups_of(recordings, grouping)
    order = np.random.default_rng(seed).permutation(len(groups))
    lengths = np.array([groups[number][1].stop - groups[number][1].start for number in order])
    enough = int(np.searchsorted(np.cumsum(lengths), rows)) + 1
    kept = [np.zeros(len(recording), bool) for recording in recordings]
    for number in order[:enough]:
        recording, span = groups[number]
        kept[recording][span] = True
    return [recording.rows(keep) for recording, keep in zip(recordings, kept, strict=True) if keep.any()]
