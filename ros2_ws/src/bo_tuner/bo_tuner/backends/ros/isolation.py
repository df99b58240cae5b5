"""The ROS environment of started nodes: a domain of their own, this machine only."""

import contextlib
import os
import socket
from collections.abc import Iterator, Sequence
from typing import IO

from bo_tuner.errors import BackendError
from bo_tuner.package_files import config_directory
from bo_tuner.ros_distribution import distribution
from bo_tuner.storage.host_lock import host_lock

# RTPS maps domains to UDP ports; above 101 they reach into the ephemeral range.
HIGHEST_DOMAIN = 101
LARGEST_DOMAIN = 232
"""That a user may name."""
FIRST_PORT = 7400
PORTS_PER_DOMAIN = 250
UNICAST_OFFSET = 10

FAST_DDS = "rmw_fastrtps"
PROFILE_VARIABLES = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE")
"""Of Fast DDS up to 2 (Jazzy), and from 3 (Kilted) on, which warns of the first."""
RANGE_VARIABLE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
LOCALHOST = "LOCALHOST"
LEASE = 3.0
"""Time [s] after which the discovery profile has forgotten a killed node for sure."""


class DomainClaim:
    """A ROS domain that no other tuner of this machine takes while the claim is held."""

    def __init__(self, namespace: str, domain: int | None = None) -> None:
        self._lock: IO[str] | None = None
        candidates = range(1, HIGHEST_DOMAIN + 1) if domain is None else (domain,)
        for candidate in candidates:
            if domain is None and _has_participant(candidate):
                continue
            try:
                self._lock = host_lock(place_name(candidate, namespace))
            except BackendError:
                # Whatever bears the name of this lock, another domain will do.
                if domain is None:
                    continue
                raise
            if self._lock is not None:
                self.domain = candidate
                return
        if domain is None:
            raise BackendError(f"no free ROS domain between 1 and {HIGHEST_DOMAIN}")
        raise BackendError(
            f"another tuner is running in ROS domain {domain}, namespace {namespace}; "
            "wait for it or set another ROS_DOMAIN_ID"
        )

    def release(self) -> None:
        """Give the domain back; the end of the process does the same."""
        if self._lock is not None:
            self._lock.close()
            self._lock = None


def profile_variable() -> str:
    """Return the environment variable of the Fast DDS that is installed for a profile."""
    return PROFILE_VARIABLES[distribution() not in ("humble", "iron", "jazzy")]


def isolated_environment(domain: int) -> dict[str, str]:
    """Environment variables to set for nodes that see this machine and `domain` only.

    Our discovery profile for Fast DDS keeps to UDP on the loopback interface: shared memory leaves
    files behind when a process is killed. It also makes a dead node known after 2 s instead of 20.
    LOCALHOST must not be set along with it, since that brings shared memory back; it is for other
    middlewares, and for a profile of the user's. A wider range of the user's stays as it is.
    """
    variables = {"ROS_DOMAIN_ID": str(domain)}
    if os.environ.get(RANGE_VARIABLE, "") not in ("", LOCALHOST):
        return variables
    variables[RANGE_VARIABLE] = LOCALHOST
    fast_dds = os.environ.get("RMW_IMPLEMENTATION", FAST_DDS).startswith(FAST_DDS)
    if fast_dds and not any(map(os.environ.get, PROFILE_VARIABLES)):
        variables[RANGE_VARIABLE] = "SYSTEM_DEFAULT"
        variables[profile_variable()] = str(config_directory() / "fastdds_profile.xml")
    return variables


@contextlib.contextmanager
def isolated(domain: int) -> Iterator[None]:
    """Set the `isolated_environment` within; a later backend does not take it for the user's."""
    variables = isolated_environment(domain)
    before = {name: os.environ.get(name) for name in variables}
    os.environ.update(variables)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


def domain_of_environment() -> int | None:
    """Return the domain that the environment names; None if it names none."""
    given = os.environ.get("ROS_DOMAIN_ID", "")
    if not given:
        return None
    if not (given.isascii() and given.isdigit() and int(given) <= LARGEST_DOMAIN):
        raise BackendError(
            f"ROS_DOMAIN_ID is {given!r}; expected a number from 0 to {LARGEST_DOMAIN}"
        )
    return int(given)


def namespace_of(ros_arguments: Sequence[str]) -> str:
    """Return the namespace that ``--ros-args`` give, the root unless they name one."""
    return named_namespace(ros_arguments) or "/"


def named_namespace(ros_arguments: Sequence[str]) -> str:
    """Return the namespace that ``--ros-args`` name; empty if they name none."""
    for argument in reversed(ros_arguments):
        if argument.startswith("__ns:="):
            return argument.removeprefix("__ns:=")
    return ""


def in_namespace(ros_arguments: Sequence[str], namespace: str) -> list[str]:
    """Return ``--ros-args`` with another namespace."""
    given = [argument for argument in ros_arguments if argument != "--"] or ["--ros-args"]
    return [*given, "-r", f"__ns:={namespace}"]


def _has_participant(domain: int) -> bool:
    port = FIRST_PORT + PORTS_PER_DOMAIN * domain + UNICAST_OFFSET
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind(("", port))
        except OSError:
            return True
    return False


def place_name(domain: int, namespace: str) -> str:
    """Return a name for files of a domain and namespace."""
    return f"domain{domain}{namespace.rstrip('/').replace('/', '-')}"
