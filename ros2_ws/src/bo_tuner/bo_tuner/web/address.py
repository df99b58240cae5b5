"""The address of the page: of this machine only, with a token that nobody can guess."""

import secrets
import socket
from dataclasses import dataclass, field

from bo_tuner.errors import OutputError

HOST = "127.0.0.1"
TOKEN_BYTES = 24


@dataclass(frozen=True)
class Address:
    """A socket that listens, and the token that it asks for.

    Attributes
    ----------
    socket
        Bound to the loopback interface; connections wait until somebody serves them.
    port
        Its port.
    token
        Whoever has it may read the page.
    """

    socket: socket.socket
    port: int
    token: str = field(default_factory=lambda: secrets.token_urlsafe(TOKEN_BYTES), repr=False)

    @property
    def url(self) -> str:
        """What to open in a browser."""
        return f"http://{HOST}:{self.port}/?token={self.token}"


def listen(port: int) -> Address:
    """Take a port of the loopback interface; 0 takes any that is free.

    Raises
    ------
    OutputError
        If it cannot be had.
    """
    taken = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    try:
        # What an earlier run has left to time out does not count as in use.
        taken.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        taken.bind((HOST, port))
        taken.listen()
    except OSError as error:
        taken.close()
        raise OutputError(
            f"--web {port}: cannot listen on {HOST}:{port}: {error.strerror}; expected a free port"
        ) from error
    return Address(taken, taken.getsockname()[1])
