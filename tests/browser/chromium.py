"""Headless Chromium, driven over the DevTools protocol by a pipe: no driver, no further package.

https://chromedevtools.github.io/devtools-protocol/: JSON messages, each ended by a NUL byte.
"""

import base64
import contextlib
import fcntl
import json
import os
import select
import shutil
import subprocess
import time
from pathlib import Path
from typing import Any

PROGRAMS = ("chromium", "chromium-browser", "google-chrome")
FLAGS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--hide-scrollbars",
    "--remote-debugging-pipe",
)
TO_BROWSER, FROM_BROWSER = 3, 4
"""Descriptors that Chromium expects."""

GONE = "Inspected target navigated or closed"
"""What the protocol answers of an expression when the page is left."""


class BrowserError(Exception):
    """The browser refused something, or said nothing in time."""


def find_chromium() -> str | None:
    """Path of a Chromium, if one is installed."""
    return next(filter(None, map(shutil.which, PROGRAMS)), None)


class Chromium:
    """A browser with one page; use it in a ``with`` block.

    Parameters
    ----------
    profile
        Empty folder for its files.

    Attributes
    ----------
    errors
        Errors and warnings in the console, exceptions, and what the network was asked for, since
        the page was opened.
    untouched
        What its user calls the page that is open, if nobody has changed anything on it.
    """

    def __init__(self, profile: Path) -> None:
        self.errors: list[str] = []
        self.requests: list[str] = []
        self.untouched: object = None
        self._events: list[dict[str, Any]] = []
        self._buffer = b""
        self._number = 0
        program = find_chromium()
        if program is None:
            raise BrowserError("no Chromium is installed")
        ours_in, self._to = os.pipe()
        self._from, ours_out = os.pipe()
        # Clear of the descriptors that Chromium expects, which the child makes of these.
        high = [fcntl.fcntl(fd, fcntl.F_DUPFD_CLOEXEC, 10) for fd in (ours_in, ours_out)]

        def place() -> None:
            os.dup2(high[0], TO_BROWSER)
            os.dup2(high[1], FROM_BROWSER)

        self._process = subprocess.Popen(
            [program, *FLAGS, f"--user-data-dir={profile}", "about:blank"],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            pass_fds=(TO_BROWSER, FROM_BROWSER),
            preexec_fn=place,
        )
        for fd in (ours_in, ours_out, *high):
            os.close(fd)
        self._session = ""
        pages = [t for t in self.call("Target.getTargets")["targetInfos"] if t["type"] == "page"]
        target = pages[0]["targetId"]
        self._session = self.call("Target.attachToTarget", targetId=target, flatten=True)[
            "sessionId"
        ]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.call(f"{domain}.enable")

    def __enter__(self) -> "Chromium":
        return self

    def __exit__(self, *_: object) -> None:
        with contextlib.suppress(BrowserError, OSError):
            self._session = ""
            self.call("Browser.close", timeout=5.0)
        try:
            self._process.wait(10.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        os.close(self._to)
        os.close(self._from)

    def open(
        self, page: Path | str, *, theme: str = "light", width: int = 1280, height: int = 900
    ) -> None:
        """Open a file or an address and wait until it is loaded."""
        self.untouched = None
        # What the page before still has under way, such as a request to a server that has ended,
        # is none of this one's errors.
        self._events.clear()
        self.call("Page.navigate", url="about:blank")
        self._wait("Page.loadEventFired")
        self.errors.clear()
        self.requests.clear()
        self.set_theme(theme)
        self.set_size(width, height)
        self._events.clear()
        self.call("Page.navigate", url=page if isinstance(page, str) else page.resolve().as_uri())
        self._wait("Page.loadEventFired")

    def set_theme(self, theme: str) -> None:
        """Emulate the reader's choice of ``light`` or ``dark``."""
        features = [{"name": "prefers-color-scheme", "value": theme}]
        self.call("Emulation.setEmulatedMedia", features=features)

    def set_size(self, width: int, height: int) -> None:
        """Set the size of the window [px]."""
        self.call(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=height,
            deviceScaleFactor=1,
            mobile=width < 600,
        )

    def evaluate(self, expression: str, timeout: float = 120.0) -> Any:
        """Evaluate JavaScript, wait for a promise, and return its value."""
        answer = self.call(
            "Runtime.evaluate",
            timeout,
            expression=expression,
            returnByValue=True,
            awaitPromise=True,
        )
        if "exceptionDetails" in answer:
            raise BrowserError(json.dumps(answer["exceptionDetails"])[:2000])
        return answer["result"].get("value")

    def wait_for(self, expression: str, timeout: float = 120.0) -> None:
        """Wait until an expression is true, also on the page that this one goes to."""
        end = time.monotonic() + timeout
        while not self._is_true(expression):
            if time.monotonic() > end:
                raise BrowserError(f"never true: {expression}")
            time.sleep(0.02)

    def _is_true(self, expression: str) -> bool:
        try:
            return bool(self.evaluate(expression))
        except BrowserError as error:
            if GONE in str(error):
                return False
            raise

    def print_pdf(self, path: Path) -> None:
        """Print the page to a PDF file."""
        page = self.call("Page.printToPDF", preferCSSPageSize=True, printBackground=True)
        path.write_bytes(base64.b64decode(page["data"]))

    def call(self, method: str, timeout: float = 120.0, **parameters: Any) -> Any:
        """Call a method of the protocol and return its result."""
        self._number += 1
        message: dict[str, Any] = {"id": self._number, "method": method, "params": parameters}
        if self._session:
            message["sessionId"] = self._session
        os.write(self._to, json.dumps(message).encode() + b"\0")
        end = time.monotonic() + timeout
        while True:
            answer = self._receive(end, method)
            if answer.get("id") == self._number:
                if "error" in answer:
                    raise BrowserError(f"{method}: {answer['error']}")
                return answer["result"]

    def _wait(self, event: str, timeout: float = 120.0) -> None:
        end = time.monotonic() + timeout
        while not any(seen["method"] == event for seen in self._events):
            self._receive(end, event)

    def _receive(self, end: float, what: str) -> dict[str, Any]:
        """Take the next message; note it if it is an event."""
        while b"\0" not in self._buffer:
            ready, _, _ = select.select([self._from], [], [], max(end - time.monotonic(), 0.0))
            chunk = os.read(self._from, 1 << 20) if ready else b""
            if not chunk:
                raise BrowserError(f"{what}: no answer")
            self._buffer += chunk
        text, _, self._buffer = self._buffer.partition(b"\0")
        message: dict[str, Any] = json.loads(text)
        if "method" in message:
            self._events.append(message)
            self._note(message["method"], message.get("params", {}))
        return message

    def _note(self, method: str, event: dict[str, Any]) -> None:
        if method == "Runtime.exceptionThrown":
            self.errors.append(json.dumps(event["exceptionDetails"])[:500])
        elif method == "Runtime.consoleAPICalled" and event["type"] in ("error", "warning"):
            self.errors.append(json.dumps(event["args"])[:500])
        elif method == "Log.entryAdded" and event["entry"]["level"] in ("error", "warning"):
            self.errors.append(event["entry"]["text"])
        elif method == "Network.requestWillBeSent":
            self.requests.append(event["request"]["url"])
