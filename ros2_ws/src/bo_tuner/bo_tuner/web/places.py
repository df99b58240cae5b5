"""Addresses of the pages on the server."""

import os
from urllib.parse import quote

HOME = "/"
RUNS = "/runs"
NEWS = "/news"
"""What changes in the list of runs; a run may have any name below `RUNS`."""
STARTED = "/started"
"""What the command that a page has started prints."""
STOP = "/started/stop"
COMPARED = "compared"
"""Behind `trials_address`, two trials side by side; their numbers are a query."""


def list_address(page: int) -> str:
    """Return the address of a page of the list of runs."""
    return f"{RUNS}?page={page}"


def news_address(page: int) -> str:
    """Return the address of what a page of the list has now."""
    return f"{NEWS}?page={page}"


def run_address(name: str) -> str:
    """Return the address of a run by the name of its folder."""
    return f"{RUNS}/{quote(os.fsencode(name))}"


def file_address(name: str, path: str) -> str:
    """Return the address of a file of a run by its path in the run folder."""
    return f"{run_address(name)}/files/{quote(os.fsencode(path))}"


def forecasts_address(name: str) -> str:
    """Return the address of predictions for values of a run's parameters, a query behind it."""
    return f"{run_address(name)}/forecast"


def start_address(name: str) -> str:
    """Return the address to which a command is sent that a run's page shows, to be started."""
    return f"{run_address(name)}/start"


def trials_address(name: str) -> str:
    """Return what the addresses of a run's trials begin with; the number follows."""
    return f"{run_address(name)}/trials/"
