"""Ports for servers of tests."""

from __future__ import annotations

import itertools
import os
import socket

# Below the ports that Linux gives to outgoing connections: one of those could be taken before the server binds it.
FIRST, COUNT, BLOCK = 12_000, 20, 1_000
# Processes that share the tests have a block of their own; others that run meanwhile most likely have another one.
_block = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw")) + os.getppid()
_numbers = itertools.cycle(range(BLOCK))


def free_port() -> int:
    """Return a port of loopback that nobody listens on, and that this process has not returned before."""
    for number in _numbers:
        port = FIRST + BLOCK * (_block % COUNT) + number
        with socket.socket() as probe:
            try:
                probe.bind(("127.0.0.1", port))
            except OSError:
                continue
            return port
    raise AssertionError("never reached: the numbers have no end")
