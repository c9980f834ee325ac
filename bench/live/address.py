"""Where the live server listens: HOST:PORT, and which names in a request are its own."""

from __future__ import annotations

import ipaddress
import re
import socket
from collections.abc import Sequence
from dataclasses import dataclass
from urllib.parse import urlsplit

from bench.errors import BadInput

DEFAULT = "127.0.0.1:0"

_AUTHORITY = re.compile(r"(?:\[(?P<address>[0-9a-f:.%]+)\]|(?P<name>[^][:@/]+))(?::[0-9]*)?", re.ASCII)


@dataclass(frozen=True)
class LiveAddress:
    """Where to listen.

    Attributes:
        host: a name or address of this machine.
        port: of the page; Foxglove's is the next one. 0 for any two.
        origins: of web pages that may connect to Foxglove's, besides the usual ones, as browsers send them.
    """

    host: str
    port: int
    origins: tuple[str, ...] = ()

    @classmethod
    def parse(cls, text: str, origins: Sequence[str] = ()) -> LiveAddress:
        """Return the address that `text` names, with further origins as `--live-origin` takes them.

        Raises:
            BadInput: it is not HOST:PORT, or one of `origins` is not an origin.
        """
        host, colon, port = text.rpartition(":")
        host = host.removeprefix("[").removesuffix("]")
        if not (colon and host and re.fullmatch(r"[0-9]{1,5}", port)) or int(port) > 65534:
            raise BadInput(
                f"{text!r} is not an address to listen on: write HOST:PORT with a port of 0 (any) to 65534, for "
                f"example {DEFAULT}; 0.0.0.0:PORT for all of this machine's networks"
            )
        return cls(host, int(port), tuple(map(_origin, origins)))

    @property
    def foxglove_port(self) -> int:
        """Where to listen for Foxglove."""
        return self.port + 1 if self.port else 0

    def url(self, scheme: str, port: int) -> str:
        """Return a URL that a viewer on this machine can open."""
        host = self.host
        if _is_any(host):
            host = socket.gethostname()
        return f"{scheme}://{f'[{host}]' if ':' in host else host}:{port}"

    def is_own(self, authority: str) -> bool:
        """Return whether `authority`, HOST or HOST:PORT, is a name by which a viewer may address this server.

        A foreign web page can let its own name resolve to this machine (DNS rebinding) and would then have access to
        what is served here. It cannot do so with an IP address or one of this machine's own names.
        """
        host = _host_of(authority)
        if host in {"localhost", self.host.lower(), socket.gethostname().lower()}:
            return True
        try:
            ipaddress.ip_address(host)
        except ValueError:
            return False
        return True


def _host_of(authority: str) -> str:
    """Return the host of HOST, HOST:PORT or [ADDRESS]:PORT, without a dot at its end; empty if it is none of them."""
    found = _AUTHORITY.fullmatch(authority.lower())
    return (found["address"] or found["name"]).removesuffix(".") if found else ""


def _origin(text: str) -> str:
    """Return an origin, SCHEME://HOST[:PORT], as a browser sends it.

    Raises:
        BadInput: it is not one.
    """
    try:
        parts = urlsplit(text)
        port = parts.port
    except ValueError:
        parts, port = urlsplit(""), None
    default = {"http": 80, "https": 443}.get(parts.scheme)
    if default is None or not parts.hostname or parts.path not in ("", "/") or parts.query or "@" in parts.netloc:
        raise BadInput(
            f"--live-origin {text}: give the address of a viewer's page, SCHEME://HOST or SCHEME://HOST:PORT with http "
            "or https: http://localhost:8080"
        )
    host = f"[{parts.hostname}]" if ":" in parts.hostname else parts.hostname
    return f"{parts.scheme}://{host}" if port in (None, default) else f"{parts.scheme}://{host}:{port}"


def _is_any(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_unspecified
    except ValueError:
        return False
