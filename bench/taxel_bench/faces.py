"""What an awaited call costs beside a call that waits: one window at a time, of the same server.

    taxel serve --listen tcp/127.0.0.1:7447 &
    python -m taxel_bench.faces tcp/127.0.0.1:7447 --model xgb

Blocks of both kinds alternate, so that both meet the same load of the machine. The ratio is the median of
the blocks' own ratios of their p50.
"""

import argparse
import asyncio
import json
import time
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from taxel.remote.async_source import AsyncPredictor, connect_async
from taxel.remote.source import RemotePredictor, connect

_WARM_UP: Final = 50
_CALLS: Final = 400


def waited(predictor: RemotePredictor, windows: NDArray[np.float32]) -> NDArray[np.float64]:
    """Microseconds of each call of a block."""
    times = np.empty(_WARM_UP + _CALLS)
    for number in range(len(times)):
        started = time.perf_counter()
        predictor.predict(windows)
        times[number] = time.perf_counter() - started
    return times[_WARM_UP:] * 1e6


async def awaited(predictor: AsyncPredictor, windows: NDArray[np.float32]) -> NDArray[np.float64]:
    """The same with calls that are awaited."""
    times = np.empty(_WARM_UP + _CALLS)
    for number in range(len(times)):
        started = time.perf_counter()
        await predictor.predict(windows)
        times[number] = time.perf_counter() - started
    return times[_WARM_UP:] * 1e6


async def compare(
    endpoint: str, model: str, transport: Literal["zenoh", "lane"], blocks: int
) -> dict[str, float]:
    """p50 in µs of both kinds over all blocks, and how they compare."""
    source = await asyncio.to_thread(connect, endpoint, transport=transport)
    async with connect_async(endpoint, transport=transport) as async_source:
        predictor, async_predictor = source.predictor(model), await async_source.predictor(model)
        window = np.asarray([predictor.manifest.typical_window], np.float32)
        pairs = [
            (np.median(waited(predictor, window)), np.median(await awaited(async_predictor, window)))
            for _ in range(blocks)
        ]
    source.close()
    sync_us, async_us = np.median(pairs, axis=0)
    ratios = [after / before for before, after in pairs]
    return {
        "sync_p50_us": round(float(sync_us), 1),
        "async_p50_us": round(float(async_us), 1),
        "ratio": round(float(np.median(ratios)), 2),
    }


def main() -> None:
    """Print one JSON object: for each transport the two p50 and their ratio."""
    parser = argparse.ArgumentParser(description="awaited calls beside calls that wait")
    parser.add_argument("endpoint")
    parser.add_argument("--model", default="xgb")
    parser.add_argument("--blocks", type=int, default=15)
    given = parser.parse_args()
    kinds: tuple[Literal["zenoh", "lane"], ...] = ("lane", "zenoh")
    results = {
        kind: asyncio.run(compare(given.endpoint, given.model, kind, given.blocks)) for kind in kinds
    }
    print(json.dumps(results, indent=1))


if __name__ == "__main__":
    main()
