"""The address of the pages: of this machine unless asked for, with a token nobody can guess."""

import contextlib
import ipaddress
import secrets
import socket
from dataclasses import dataclass, field

from bo_tuner.errors import OutputError

HOST = "127.0.0.1"
TOKEN_BYTES = 24
ELSEWHERE = ("192.0.2.1", 9)
"""An address of nobody (RFC 5737): which of its own a machine would use to reach it."""


@dataclass(frozen=True)
class Address:
    """A socket that listens, and the token that it asks for.

    Attributes
    ----------
    socket
        Bound to the interface; connections wait until somebody serves them.
    port
        Its port.
    host
        What it was bound to: that of the loopback interface, unless other machines are to reach
        the pages.
    token
        Whoever has it may read the pages.
    """

    socket: socket.socket
    port: int
    host: str = HOST
    token: str = field(default_factory=lambda: secrets.token_urlsafe(TOKEN_BYTES), repr=False)

    @property
    def is_local(self) -> bool:
        """Whether only this machine reaches it."""
        return self.host == HOST

    @property
    def ways(self) -> list[str]:
        """How to open it from another machine, or what to consider if that is possible; lines."""
        port = self.port
        if self.is_local:
            return [
                f"from another machine: ssh -L {port}:{HOST}:{port} {socket.gethostname()}, and "
                "there the same address"
            ]
        return [
            "whoever has this address can open it from other machines; nothing is encrypted: use "
            "it in a network that you trust"
        ]

    @property
    def url(self) -> str:
        """What to open in a browser."""
        host = self.host
        if ipaddress.ip_address(host).is_unspecified:
            host = _own_address()
        return f"http://{host}:{self.port}/?token={self.token}"


def listen(port: int, host: str | None = None, option: str = "--web") -> Address:
    """Take a port of the loopback interface, or of that of a `host`; 0 takes any that is free."""
    asked, host = f"{option} {port}" if host is None else f"--web-host {host}", host or HOST
    taken = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    try:
        # What an earlier run has left to time out does not count as in use.
        taken.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        taken.bind((host, port))
        taken.listen()
    except OSError as error:
        taken.close()
        raise OutputError(
            f"{asked}: cannot listen on {host}:{port}: {error.strerror}; expected a free port"
            + ("" if host == HOST else " of an address of this machine")
        ) from error
    return Address(taken, taken.getsockname()[1], host)


def is_own_host(host: str, port: int, bound: str) -> bool:
    """Whether a request names the pages by an address of theirs, in its header ``Host``.

    A page of a stranger could send requests by a name that it has resolve to this machine (DNS
    rebinding). It cannot do so by a number, so that of a page which other machines reach any
    number is one of its addresses.
    """
    name, _, given = host.rpartition(":")
    if given != str(port):
        return False
    if name in (HOST, "localhost"):
        return True
    with contextlib.suppress(ValueError):
        return bound != HOST and ipaddress.ip_address(name).version == 4
    return False


def _own_address() -> str:
    """Return the address by which others reach this machine; that of its loopback without any."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            # Of a datagram socket this only looks up a route; nothing is sent.
            probe.connect(ELSEWHERE)
        except OSError:
            return HOST
        return str(probe.getsockname()[0])
