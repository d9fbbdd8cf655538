"""`taxel gazebo`: fingertips for a world in Gazebo, without a plugin."""

from typing import Annotated

import typer

from taxel.commands.cli import ERR, needs
from taxel.commands.models import Connect, Repository, open_source
from taxel.predictor import DEFAULT_MODEL


@needs("gazebo", "google.protobuf")
def gazebo(
    world: Annotated[str, typer.Option(help="The world's name in its SDF.")],
    finger: Annotated[
        list[str],
        typer.Option(
            metavar="NAME=MODEL/LINK/SENSOR",
            help="A fingertip, once for each: a name of your choice, and its link and contact sensor as in "
            "the SDF. NAME=MODEL/LINK:TOPIC if the sensor has a topic of its own.",
        ),
    ],
    frame: Annotated[
        str,
        typer.Option(
            metavar="POSE",
            help="The sensor's frame in the link's, as a pose in SDF: x y z, m, roll pitch yaw, rad.",
        ),
    ] = "0 0 0 0 0 0",
    poses: Annotated[
        str | None,
        typer.Option(
            metavar="TOPIC",
            help="The topic that has the links' poses.  [default: /world/WORLD/dynamic_pose/info]",
        ),
    ] = None,
    rate: Annotated[float, typer.Option(help="How often the world steps, Hz: 1 / max_step_size.")] = 1000.0,
    model: Annotated[str, typer.Option(help="Which model predicts.")] = DEFAULT_MODEL,
    connect: Connect = None,
    repository: Repository = None,
    router: Annotated[
        str | None,
        typer.Option(
            metavar="ENDPOINT", help="A zenoh router, as tcp/HOST:PORT.  [default: found by multicast]"
        ),
    ] = None,
    partition: Annotated[
        str | None, typer.Option(help="Of Gazebo's transport.  [default: GZ_PARTITION, or HOST:USER]")
    ] = None,
    strict: Annotated[
        bool, typer.Option("--strict", help="End with an error at the first input that is or looks wrong.")
    ] = False,
) -> None:
    """Take contacts from Gazebo's topics and publish the channels of fingertips. Ctrl-C ends it.

    Untested with Gazebo itself: it is written from Gazebo's sources. It speaks as Gazebo 15 (Jetty) and
    newer do with GZ_TRANSPORT_IMPLEMENTATION=zenoh, so that Gazebo needs neither a plugin nor be installed
    here. The finger `ff` gives /ff/tactile, gz.msgs.Float_V, 21 counts.
    """
    from taxel.gazebo.settings import BridgeSettings, GazeboFinger, mount_of
    from taxel.gazebo.zenoh_bridge import ZenohBridge

    fingers = tuple(GazeboFinger.parsed(text, world) for text in finger)
    settings = BridgeSettings(world, fingers, poses, mount_of(frame), rate, strict)
    with (
        open_source(connect, repository) as source,
        ZenohBridge(source.predictor(model), settings, partition=partition, router=router) as running,
    ):
        for one in fingers:
            ERR.print(f"{one.name}: {one.contacts} gives {one.channels}", markup=False, soft_wrap=True)
        running.run()
