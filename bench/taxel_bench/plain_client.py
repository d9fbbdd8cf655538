"""A client written with zenoh alone: it shares nothing with the project's client."""

import json

import zenoh


def client_config(endpoint: str) -> zenoh.Config:
    """The configuration of a zenoh session that is a client of one server."""
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("connect/endpoints", json.dumps([endpoint]))
    return config
