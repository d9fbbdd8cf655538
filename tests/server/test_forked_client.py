"""A client in a process that was forked: typed errors, no wait, and a clean end."""

import os
import subprocess
import sys
from collections.abc import Callable

import pytest

from taxel_server.engine import Engine

ServerStarter = Callable[..., str]

CLIENT = """
import asyncio, gc, os, sys, warnings
import numpy as np
import taxel

warnings.simplefilter("ignore")
windows = np.zeros((1, 6), np.float32)


def refused(call):
    try:
        call()
    except taxel.Unavailable as error:
        return "fork" in str(error)
    return False


def in_child(*calls):
    child = os.fork()
    if not child:
        outcomes = [refused(call) for call in calls]
        return None if all(outcomes) else sys.exit(f"not refused: {outcomes}")
    assert os.waitpid(child, 0)[1] == 0
    return child


def with_sources():
    place = sys.argv[1]
    with taxel.connect(place, transport="zenoh") as far, taxel.connect(place, transport="lane") as near:
        predictors = [source.predictor("skin") for source in (far, near)]
        before = [predictor.predict(windows) for predictor in predictors]
        child = in_child(
            far.models,
            near.models,
            lambda: predictors[0].predict(windows),
            lambda: predictors[1].predict(windows),
            lambda: taxel.connect(place),
        )
        if child:
            after = [predictor.predict(windows) for predictor in predictors]
            np.testing.assert_array_equal(after, before)
    return child


async def opened():
    source = await taxel.connect_async(sys.argv[1])
    return source, await source.predictor("skin")


# The child leaves `with`, forgets its sources, and ends as any program does.
if with_sources():
    gc.collect()
    source, predictor = asyncio.run(opened())
    child = in_child(lambda: asyncio.run(source.models()), lambda: asyncio.run(predictor.predict(windows)))
    if child:
        print("answered")
        sys.stdout.flush()
        os._exit(0)
else:
    gc.collect()
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="forks")
def test_a_forked_client_is_told_what_to_do(engine: Engine, start: ServerStarter) -> None:
    done = subprocess.run(
        [sys.executable, "-c", CLIENT, start(engine)], capture_output=True, text=True, timeout=60
    )
    assert (done.stdout, done.stderr, done.returncode) == ("answered\n", "", 0)
