"""HTTPS on a local network, which phones' cameras need: an authority of one's own, made once, and certificates."""

from __future__ import annotations

import os
import socket
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

import segno
import trustme

from app.commands.console import console
from app.limits import limit
from app.web.phones import PhoneAccess

FOLDER = "https"
# Nothing is ever sent there (RFC 5737): the system only says by which of its addresses it would.
ROUTE_PROBE = ("192.0.2.1", 9)


@dataclass(frozen=True, slots=True, kw_only=True)
class CertificateOptions:
    """How long a certificate lasts."""

    valid_days: int = limit(
        397,
        "Days for which the server's certificate is valid; each start makes a new one.",
        chosen="By hand: below the 825 days above which iOS refuses a certificate.",
    )


OPTIONS = CertificateOptions()


@dataclass(frozen=True, slots=True)
class Certificate:
    """Files of the server's certificate with its key, and of the authority that signed it."""

    chain: Path
    key: Path
    authority: Path


def make_certificate(data_dir: Path, names: list[str]) -> Certificate:
    """Return a certificate for names and addresses, signed by the data folder's authority, which is made once."""
    folder = data_dir / FOLDER
    folder.mkdir(parents=True, exist_ok=True)
    authority_file, authority_key = folder / "authority.pem", folder / "authority-key.pem"
    if authority_file.is_file() and authority_key.is_file():
        authority = trustme.CA.from_pem(authority_file.read_bytes(), authority_key.read_bytes())
    else:
        authority = trustme.CA(organization_name="Roomfix", organization_unit_name=socket.gethostname())
        _write_private(authority_key, authority.private_key_pem.bytes())
        authority_file.write_bytes(authority.cert_pem.bytes())
    until = datetime.now(UTC) + timedelta(days=OPTIONS.valid_days)
    issued = authority.issue_cert(*names, common_name=names[0], not_after=until)
    certificate = Certificate(folder / "server.pem", folder / "server-key.pem", authority_file)
    _write_private(certificate.key, issued.private_key_pem.bytes())
    certificate.chain.write_bytes(b"".join(part.bytes() for part in issued.cert_chain_pems))
    return certificate


def _write_private(path: Path, data: bytes) -> None:
    """Write a file that only its owner can read."""
    path.unlink(missing_ok=True)
    with os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as file:
        file.write(data)


def own_names(host: str) -> list[str]:
    """Return the addresses and names that a server on `host` is reached by, the best one for phones first."""
    if host not in ("0.0.0.0", "::", ""):  # noqa: S104 - compared, not bound
        return list(dict.fromkeys([host, "localhost", "127.0.0.1"]))
    found = [_outward_address()]
    try:
        known = socket.getaddrinfo(socket.gethostname(), None, socket.AF_INET)
        found += [str(entry[4][0]) for entry in known]
    except OSError:
        # A host name that nothing resolves is no address.
        pass
    name = socket.gethostname()
    names = [*[each for each in found if each], name, f"{name.removesuffix('.local')}.local"]
    return list(dict.fromkeys([*names, "localhost", "127.0.0.1"]))


def _outward_address() -> str | None:
    """Return the address of this machine on the network that leads outward, None without one."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(ROUTE_PROBE)
        except OSError:
            return None
        return str(probe.getsockname()[0])


def print_phone_access(access: PhoneAccess, path: str = "") -> None:
    """Print the address for phones, its QR code, and how to trust it."""
    link = access.https + path
    console.print(f"\nPhones: [bold]{link.partition('#')[0]}[/bold]\n", highlight=False, soft_wrap=True)
    console.print(qr_text(link), highlight=False, soft_wrap=True)
    console.print(
        f"The browser warns until the phone trusts this server: open {access.https}ca.crt there and install it "
        "(docs/https.md).\n",
        highlight=False,
        soft_wrap=True,
    )


def qr_text(link: str) -> str:
    """Return a QR code in block characters, two modules a character, light on dark as terminals are."""
    rows = [[bool(module) for module in row] for row in segno.make(link, micro=False).matrix_iter(border=2)]
    rows += [[False] * len(rows[0])] * (len(rows) % 2)
    blocks = {(False, False): "█", (False, True): "▀", (True, False): "▄", (True, True): " "}
    pairs = zip(rows[::2], rows[1::2], strict=True)
    return "\n".join("".join(blocks[a, b] for a, b in zip(top, low, strict=True)) for top, low in pairs)
