"""zenoh's endpoints: what both ends say of one that is malformed, or that cannot be had."""

from typing import Final

EXPECTED: Final = "expected PROTOCOL/ADDRESS, such as tcp/127.0.0.1:7447"
"""What an endpoint has to look like."""


def reason_of(error: Exception) -> str:
    """What zenoh's error says, without where in zenoh's own code it arose."""
    return str(error).partition(" at /")[0]
