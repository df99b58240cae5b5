"""Addresses of the pages on the server."""

import os
from urllib.parse import quote

HOME = "/"
RUNS = "/runs"


def run_address(name: str) -> str:
    """Return the address of a run by the name of its folder."""
    return f"{RUNS}/{quote(os.fsencode(name))}"


def file_address(name: str, path: str) -> str:
    """Return the address of a file of a run by its path in the run folder."""
    return f"{run_address(name)}/files/{quote(os.fsencode(path))}"


def trials_address(name: str) -> str:
    """Return what the addresses of a run's trials begin with; the number follows."""
    return f"{run_address(name)}/trials/"
