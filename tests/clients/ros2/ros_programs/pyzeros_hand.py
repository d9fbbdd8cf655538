"""Plays the rest of a robot by pyzeros, another author's client of rmw_zenoh; run by its Python.

    python pyzeros_hand.py ENDPOINT STEPS

stdout: {"arrays": [[counts]], "token": the publisher's token, "gid": the publisher's, in hexadecimal}
"""

import asyncio
import json
import sys
from typing import Any

import asyncio_for_robotics as afor
import pyzeros
import zenoh
from ros2_pyterfaces.cyclone import all_msgs

START_S = 1_700_000_000


def stamped(kind: Any, step: int, **fields: Any) -> Any:
    stamp = all_msgs.Time(sec=START_S + step // 100, nanosec=step % 100 * 10_000_000)
    return kind(header=all_msgs.Header(stamp=stamp, frame_id="ff_biotac"), **fields)


@afor.scoped
async def play(steps: int) -> dict[str, Any]:
    wrenches = pyzeros.Pub(all_msgs.WrenchStamped, "ff/wrench")
    points = pyzeros.Pub(all_msgs.PointStamped, "ff/point")
    arrays = pyzeros.Sub(all_msgs.Float32MultiArray, "ff/tactile")
    while not all(each.zenoh_pub.matching_status for each in (wrenches, points)):
        await asyncio.sleep(0.01)
    for step in range(steps):
        force = all_msgs.Vector3(x=0.0, y=0.2, z=0.02 * step)
        wrench = all_msgs.Wrench(force=force, torque=all_msgs.Vector3(x=0.0, y=0.0, z=0.0))
        place = all_msgs.Point(x=-0.001 * (step % 5), y=0.0, z=-0.007)
        points.publish(stamped(all_msgs.PointStamped, step, point=place))
        wrenches.publish(stamped(all_msgs.WrenchStamped, step, wrench=wrench))
    heard = []
    async for message in arrays.listen_reliable(queue_size=steps):
        heard.append([float(value) for value in message.data])
        # The last sample's window is the last one.
        if len(heard) == int(sys.argv[3]):
            break
    return {"arrays": heard, "token": wrenches.token_keyexpr, "gid": bytes(wrenches.gid).hex()}


config = zenoh.Config()
for key, value in {
    "mode": "client",
    "connect/endpoints": [sys.argv[1]],
    "scouting/multicast/enabled": False,
}.items():
    config.insert_json5(key, json.dumps(value))
with zenoh.open(config) as session, pyzeros.auto_context("hand", session, "/rh", 3):
    json.dump(asyncio.run(play(int(sys.argv[2]))), sys.stdout)
