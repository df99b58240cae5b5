"""Options of commands that serve pages, and how their address is told."""

import argparse
import ipaddress
from collections.abc import Callable

from bo_tuner.cli.common import Group
from bo_tuner.web.address import Address

LARGEST_PORT = 65535


def add_host_argument(group: Group, serves: str) -> None:
    """Add the option to serve pages to other machines; `serves` is the option that serves them."""
    group.add_argument(
        "--web-host",
        type=_host,
        metavar="ADDRESS",
        help=f"with {serves}: let other machines open the pages, at this IPv4 address of this "
        "machine, or at all with 0.0.0.0; the token is asked for, but nothing is encrypted",
    )


def add_control_argument(group: Group, serves: str, what: str) -> None:
    """Add the option that pages may do `what`; `serves` is the option that serves them."""
    group.add_argument(
        "--web-control", action="store_true", help=f"with {serves}: the page may {what}"
    )


def port(text: str) -> int:
    """Read the number of a port; 0 stands for any."""
    if not text.isdecimal() or int(text) > LARGEST_PORT:
        raise argparse.ArgumentTypeError(f"{text}: expected a port, 0 to {LARGEST_PORT}")
    return int(text)


def tell_address(address: Address, what: str, tell: Callable[[str], None]) -> None:
    """Tell where pages are, and how to open them from another machine."""
    tell(f"{what}: {address.url}")
    for line in address.ways:
        tell(line)


def _host(text: str) -> str:
    """Read an IPv4 address."""
    try:
        return str(ipaddress.IPv4Address(text))
    except ValueError:
        raise argparse.ArgumentTypeError(
            f"{text}: expected an IPv4 address of this machine, or 0.0.0.0 for all of them"
        ) from None
