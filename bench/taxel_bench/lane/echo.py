"""The floor of the lane: a program that answers each message at once with bytes, and does nothing else.

python -m taxel_bench.lane.echo PATH BYTES
"""

import gc
import socket
import sys


def main(path: str, size: int) -> None:
    """Answer the one client of a unix socket until it goes."""
    reply = bytes(size)
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(path)
        listener.listen()
        print("ready", flush=True)
        client, _ = listener.accept()
    gc.disable()
    while client.recv(65_536):
        client.send(reply)


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]))
