"""Speaks as Gazebo's sources say, with eclipse-zenoh and protobuf alone; it takes nothing of Taxel.

    python stranger.py ENDPOINT scenario.json > heard.json

It listens at ENDPOINT as a peer. As Gazebo does, it publishes only what somebody subscribes to. A scenario
has the partition, the topics to hear, how many messages to wait for, and what to publish, in its order.
"""

import json
import re
import sys
import time
from pathlib import Path
from queue import SimpleQueue
from typing import Any

import zenoh
from google.protobuf import descriptor_pb2, descriptor_pool, json_format, message_factory
from zenoh.handlers import Callback


def messages() -> dict[str, Any]:
    """The classes of `gz_msgs.proto`, by name."""
    field_type = descriptor_pb2.FieldDescriptorProto
    file = descriptor_pb2.FileDescriptorProto(name="gz_msgs.proto", package="gz.msgs", syntax="proto3")
    text = Path(__file__).with_name("gz_msgs.proto").read_text()
    for name, body in re.findall(r"message (\w+) \{(.*)\}", text):
        message = file.message_type.add(name=name)
        for repeated, kind, field, number in re.findall(r"(repeated )?(\w+) (\w+) = (\d+);", body):
            added = message.field.add(name=field, number=int(number), label=3 if repeated else 1)
            if kind[0].isupper():
                added.type, added.type_name = field_type.TYPE_MESSAGE, f".gz.msgs.{kind}"
            else:
                added.type = field_type.Type.Value(f"TYPE_{kind.upper()}")
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)
    names = [f"gz.msgs.{message.name}" for message in file.message_type]
    return {name: message_factory.GetMessageClass(pool.FindMessageTypeByName(name)) for name in names}


def open_peer(endpoint: str) -> zenoh.Session:
    config = zenoh.Config()
    config.insert_json5("mode", '"peer"')
    config.insert_json5("listen/endpoints", json.dumps([endpoint]))
    config.insert_json5("scouting/multicast/enabled", "false")
    return zenoh.open(config)


def wait_for_subscriber(session: zenoh.Session, partition: str, topic: str, kind: str) -> None:
    """As `HasConnections` of Gazebo's publishers: by the token of a subscription of the right type."""
    mangled = topic.replace("/", "%")
    token = f"@gz/%{partition}/*/*/*/MS/%/%/%/{mangled}/{kind}/%/%"
    while not [reply for reply in session.liveliness().get(token) if reply.ok is not None]:
        time.sleep(0.02)


def main() -> None:
    scenario, classes = json.loads(Path(sys.argv[2]).read_text()), messages()
    session, partition = open_peer(sys.argv[1]), scenario["partition"]
    heard: SimpleQueue[zenoh.Sample] = SimpleQueue()
    subscribers = [
        session.declare_subscriber(f"@/{partition}@{topic}", Callback(heard.put, indirect=False))
        for topic in scenario["hear"]
    ]
    publishers: dict[str, Any] = {}
    for topic, kind in {(each["topic"], each["type"]) for each in scenario["publish"]}:
        wait_for_subscriber(session, partition, topic, kind)
        publishers[topic] = session.declare_publisher(f"@/{partition}@{topic}")
        while not publishers[topic].matching_status:
            time.sleep(0.01)
    for each in scenario["publish"]:
        message = json_format.ParseDict(each["message"], classes[each["type"]]())
        publishers[each["topic"]].put(message.SerializeToString(), attachment=each["type"])
    told = []
    for _ in range(scenario["wait_for"]):
        sample = heard.get(timeout=60)
        assert sample.attachment is not None
        kind = sample.attachment.to_string()
        message = classes[kind].FromString(sample.payload.to_bytes())
        told.append(
            {
                "topic": str(sample.key_expr).partition(f"@/{partition}@")[2],
                "type": kind,
                "stamp": [message.header.stamp.sec, message.header.stamp.nsec],
                "data": list(message.data),
            }
        )
    tokens = [str(reply.ok.key_expr) for reply in session.liveliness().get("@gz/**") if reply.ok]
    json.dump({"heard": told, "tokens": sorted(tokens), "more": heard.qsize()}, sys.stdout)
    for subscriber in subscribers:
        subscriber.undeclare()
    session.close()  # type: ignore[no-untyped-call]


if __name__ == "__main__":
    main()
