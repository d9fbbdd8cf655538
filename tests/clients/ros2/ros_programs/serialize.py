"""Reads CDR by rclpy and writes it again; run by ROS's Python.

stdin: {type: hexadecimal CDR}; stdout: {type: [fields, hexadecimal CDR as rclpy writes it]}.
"""

import json
import sys
from importlib import import_module
from typing import Any

from rclpy.serialization import deserialize_message, serialize_message


def plain(value: Any) -> Any:
    """A field's value as JSON has it."""
    if hasattr(value, "get_fields_and_field_types"):
        return {name: plain(getattr(value, name)) for name in value.get_fields_and_field_types()}
    if isinstance(value, bytes):
        return value[0]
    if isinstance(value, str | int | float):
        return value
    return [plain(each) for each in value]


answers = {}
for name, payload in json.load(sys.stdin).items():
    package, kind, short = name.split("/")
    message_type = getattr(import_module(f"{package}.{kind}"), short)
    message = deserialize_message(bytes.fromhex(payload), message_type)
    answers[name] = plain(message), serialize_message(message).hex()
json.dump(answers, sys.stdout)
