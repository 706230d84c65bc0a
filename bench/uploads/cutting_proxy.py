"""A proxy that breaks connections at given numbers of bytes, as a bad network does."""

from __future__ import annotations

import contextlib
import socket
import struct
import threading
from collections.abc import Iterator, Sequence
from urllib.parse import urlsplit

PIECE_BYTES = 65_536
# Closing a socket with this sends a reset: what was in flight is lost.
RESET = struct.pack("ii", 1, 0)


class CuttingProxy:
    """Passes bytes between clients and a server; breaks the connection after each given number of them from clients.

    `cut_at` are byte counts, rising, over all connections together.
    """

    def __init__(self, server_url: str, cut_at: Sequence[int]) -> None:
        self.cuts = 0
        self._target = urlsplit(server_url).hostname, urlsplit(server_url).port
        self._cut_at, self._passed, self._lock = list(cut_at), 0, threading.Lock()
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.url = f"http://127.0.0.1:{self._listener.getsockname()[1]}"
        threading.Thread(target=self._accept, daemon=True).start()

    def close(self) -> None:
        """Take no more connections."""
        self._listener.close()

    def _accept(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                client, _ = self._listener.accept()
                server = socket.create_connection(self._target)
                for pair in ((client, server, True), (server, client, False)):
                    threading.Thread(target=self._pass, args=pair, daemon=True).start()

    def _pass(self, source: socket.socket, target: socket.socket, is_from_client: bool) -> None:
        with contextlib.suppress(OSError):
            while piece := source.recv(PIECE_BYTES):
                if is_from_client and self._is_cut(len(piece)):
                    for end in (source, target):
                        end.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, RESET)
                        end.shutdown(socket.SHUT_RD)
                        end.close()
                    return
                target.sendall(piece)
        with contextlib.suppress(OSError):
            target.shutdown(socket.SHUT_WR)

    def _is_cut(self, count: int) -> bool:
        with self._lock:
            self._passed += count
            if not self._cut_at or self._passed < self._cut_at[0]:
                return False
            self._cut_at.pop(0)
            self.cuts += 1
            return True


@contextlib.contextmanager
def cutting_proxy(server_url: str, length: int, cuts: int) -> Iterator[CuttingProxy]:
    """Give a proxy that breaks a number of times, evenly, while `length` bytes pass."""
    proxy = CuttingProxy(server_url, [length * (i + 1) // (cuts + 1) for i in range(cuts)])
    try:
        yield proxy
    finally:
        proxy.close()
