"""The library that draws interactive figures, Plotly: compressed in a file, or cached by a browser.

A page that is a file has it within itself. Pages on the server lead to one address of it, which
changes with its version, so that a browser loads it once.
"""

import base64
import gzip
import hashlib
import importlib.resources
from functools import cache

ADDRESS = "/plotly-{}.js"
"""Of the library on the server, with the beginning of its digest."""
DIGITS = 12


@cache
def text() -> str:
    """Return its script from its file: importing the package takes a second."""
    path = importlib.resources.files("plotly") / "package_data" / "plotly.min.js"
    return path.read_text(encoding="utf-8").strip()


@cache
def compressed() -> bytes:
    """Return its script compressed by gzip, the same bytes each time."""
    return gzip.compress(text().encode(), mtime=0)


@cache
def embedded() -> str:
    """Return its compressed script as the text of a page."""
    return base64.b64encode(compressed()).decode()


def address() -> str:
    """Return where the server has it."""
    return ADDRESS.format(hashlib.sha256(compressed()).hexdigest()[:DIGITS])
