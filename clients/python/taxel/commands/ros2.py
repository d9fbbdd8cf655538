"""`taxel ros2`: fingertips as a node of a ROS 2 network that runs on rmw_zenoh."""

import os
from typing import Annotated

import typer

from taxel.commands.cli import ERR, needs
from taxel.commands.models import Connect, Repository, open_source
from taxel.errors import SettingsError
from taxel.predictor import DEFAULT_MODEL
from taxel.ros2.settings import SHADOW_FINGERS, Inputs, NodeSettings

_DEFAULTS = NodeSettings()


@needs("ros2", "rosbags", "xxhash")
def ros2(
    model: Annotated[str, typer.Option(help="Which model predicts.")] = DEFAULT_MODEL,
    connect: Connect = None,
    repository: Repository = None,
    router: Annotated[
        str, typer.Option(metavar="ENDPOINT", help="The zenoh router of the ROS 2 network, rmw_zenohd.")
    ] = "tcp/localhost:7447",
    domain: Annotated[
        int | None, typer.Option(min=0, max=232, help="The ROS domain.  [default: ROS_DOMAIN_ID, or 0]")
    ] = None,
    namespace: Annotated[str, typer.Option(help="Of all topics, such as /rh.")] = "/",
    node: Annotated[str, typer.Option(help="The node's name.")] = "taxel",
    fingers: Annotated[str, typer.Option(help="Names, with commas between them.")] = ",".join(
        SHADOW_FINGERS
    ),
    frame_id: Annotated[
        str, typer.Option(help="The frame that messages must name; {finger} stands for the finger.")
    ] = _DEFAULTS.frame_id,
    inputs: Annotated[Inputs, typer.Option(help="Which messages bring contacts.")] = _DEFAULTS.inputs,
    rate: Annotated[
        float, typer.Option(help="How often a finger's contacts come, Hz.")
    ] = _DEFAULTS.rate_hz,
    pair_within: Annotated[
        float, typer.Option(help="How far the stamps of a wrench and its point may differ, s.")
    ] = _DEFAULTS.pair_within_s,
    stale_after: Annotated[
        float, typer.Option(help="After so long without a contact a finger is stale, s.")
    ] = _DEFAULTS.stale_after_s,
    strict: Annotated[
        bool,
        typer.Option("--strict", help="End with an error at the first contact that looks wrong."),
    ] = False,
) -> None:
    """Take contacts from ROS 2 topics and publish the channels of fingertips. Ctrl-C ends it.

    It speaks as rmw_zenoh does (Jazzy and newer), so that ROS need not be installed here. The finger `ff`
    takes `ff/wrench` and `ff/point`, or `ff/contact`, and gives `ff/tactile`; `tactile` has the whole
    Shadow hand, and /diagnostics says how well it goes.
    """
    from taxel.ros2.zenoh_node import ZenohNode

    settings = NodeSettings(
        tuple(name.strip() for name in fingers.split(",")),
        frame_id,
        inputs,
        rate,
        pair_within,
        stale_after,
        strict,
    )
    with (
        open_source(connect, repository) as source,
        ZenohNode(
            source.predictor(model),
            settings,
            router=router,
            domain=_domain() if domain is None else domain,
            name=node,
            namespace=namespace,
        ) as running,
    ):
        ERR.print(f"node {node} at {router}: takes contacts of {', '.join(settings.fingers)}", markup=False)
        running.run()


def _domain() -> int:
    """The domain that the environment names, as for ROS itself."""
    text = os.environ.get("ROS_DOMAIN_ID") or "0"
    if not (text.isascii() and text.isdigit() and int(text) <= 232):
        raise SettingsError(f"ROS_DOMAIN_ID is {text!r}: expected a whole number from 0 to 232")
    return int(text)
