"""The key of a request: in its headers, never in its address."""

from __future__ import annotations

import ipaddress

from starlette.requests import HTTPConnection

# A browser can't set headers of a WebSocket; it offers these two as subprotocols, the second with the key after it.
SUBPROTOCOL = "roomfix"
KEY_SUBPROTOCOL = "roomfix.key."
# A subscriber has at least this much of IPv6, so that single addresses of it mean nothing.
SUBSCRIBER_PREFIX_BITS = 64


def key_of(connection: HTTPConnection) -> str | None:
    """Return the key that a request or WebSocket brings, None when it brings none."""
    scheme, _, given = connection.headers.get("authorization", "").partition(" ")
    if scheme.lower() == "bearer" and given.strip():
        return given.strip()
    if connection.scope["type"] == "websocket":
        offered = connection.scope.get("subprotocols", [])
        return next(
            (name[len(KEY_SUBPROTOCOL) :] for name in offered if name.startswith(KEY_SUBPROTOCOL)), None
        )
    return None


def address_of(connection: HTTPConnection) -> str:
    """Return the address that calls, of IPv6 the network of the subscriber."""
    host = connection.client.host if connection.client is not None else "unknown"
    try:
        address = ipaddress.ip_address(host)
    except ValueError:
        return host
    if address.version == 4:
        return host
    return str(ipaddress.ip_network((address, SUBSCRIBER_PREFIX_BITS), strict=False))


def is_loopback(host: str) -> bool:
    """Whether a host's name or address is of this machine alone."""
    if host.lower() == "localhost":
        return True
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return False
