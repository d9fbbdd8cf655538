"""Payloads that are nearly right: a valid one with random changes."""

from collections.abc import Iterator

import numpy as np


def mutations(valid: bytes, count: int, seed: int) -> Iterator[bytes]:
    """So many changed copies, always the same for the same seed; each has one to three changes."""
    rng = np.random.default_rng(seed)
    for _ in range(count):
        changed = bytearray(valid)
        for _ in range(rng.integers(1, 4)):
            _change(changed, rng)
        yield bytes(changed)


def _change(data: bytearray, rng: np.random.Generator) -> None:
    """One change: bits, bytes, a part that is lost, repeated or overwritten, or an end that is missing."""
    if not data:
        return
    start = int(rng.integers(len(data)))
    stop = min(start + int(rng.integers(1, 17)), len(data))
    kind = rng.integers(7)
    if kind == 0:
        data[start] ^= 1 << int(rng.integers(8))
    elif kind == 1:
        data[start:stop] = rng.bytes(stop - start)
    elif kind == 2:
        del data[start:stop]
    elif kind == 3:
        data[start:start] = data[start:stop]
    elif kind == 4:
        del data[start:]
    elif kind == 5:
        data += rng.bytes(int(rng.integers(1, 33)))
    else:
        # The largest and the smallest numbers, NaN and infinity.
        extremes = (b"\xff\xff\xff\xff", b"\0\0\0\0", b"\0\0\xc0\x7f", b"\0\0\x80\xff", b"\xff\xff\xff\x7f")
        data[start : start + 4] = extremes[int(rng.integers(len(extremes)))]
