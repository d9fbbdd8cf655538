import socket

import psutil
import pytest

from taxel_bench.load.usage import ServerUsage, cpu_seconds


def test_what_came_after_a_moment() -> None:
    before = ServerUsage(10, 4, 12, {"1": 2, "4": 2}, 1.5)
    after = ServerUsage(15, 7, 30, {"1": 2, "4": 3, "8": 2}, 1.75)
    assert after.since(before) == ServerUsage(5, 3, 18, {"4": 1, "8": 2}, 0.25)


def test_processor_time_unknown_once_is_unknown() -> None:
    before, after = ServerUsage(0, 0, 0, {}, None), ServerUsage(1, 1, 1, {"1": 1}, 2.0)
    assert after.since(before).cpu_s is None


def test_a_process_that_listens_here_is_found() -> None:
    with socket.create_server(("127.0.0.1", 0)) as listening:
        port = listening.getsockname()[1]
        before = sum(psutil.Process().cpu_times()[:2])
        found = cpu_seconds(f"tcp/localhost:{port}?rel=1#iface=lo")
        assert found is not None
        assert before <= found <= sum(psutil.Process().cpu_times()[:2])
        # TEST-NET-1: nobody's address.
        assert cpu_seconds(f"tcp/192.0.2.1:{port}") is None
    assert cpu_seconds(f"tcp/127.0.0.1:{port}") is None


@pytest.mark.parametrize("endpoint", ["unixsock-stream/taxel.sock", "serial/ttyS0#baudrate=9600"])
def test_endpoints_without_a_port_tell_no_process(endpoint: str) -> None:
    assert cpu_seconds(endpoint) is None
