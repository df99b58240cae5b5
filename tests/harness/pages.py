"""The pages that a command serves, as the tests ask for them."""

import http.client
import re

from commands import Fork
from waiting import DEADLINE, wait_until

ADDRESS = re.compile(r"(http://[\d.]+:(\d+)/)\?token=([\w-]+)")


class Pages:
    """Pages at the address that a command has printed.

    Parameters
    ----------
    text
        What it has printed.
    """

    def __init__(self, text):
        self.address, port, self.token = ADDRESS.search(text).groups()
        self.port = int(port)
        self.entrance = f"{self.address}?token={self.token}"
        self.origin = {"Origin": f"http://127.0.0.1:{self.port}"}

    def ask(self, path, *, method="GET", token=True, body=None, **headers):
        """Status, headers and text of an answer."""
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=DEADLINE)
        cookie = {"Cookie": f"bo_tuner_{self.port}={self.token}"} if token else {}
        connection.request(method, path, body=body, headers=cookie | headers)
        answer = connection.getresponse()
        text = answer.read().decode()
        connection.close()
        return answer.status, answer.headers, text

    def listing(self):
        """The list of runs, once all of them are read."""
        while " data-unread=" in (page := self.ask("/runs")[2]):
            pass
        return page

    def control_token(self, path="/"):
        return re.search(r'data-token="([\w-]+)"', self.ask(path)[2]).group(1)


class ServedRuns(Pages):
    """The runs in a folder, served by ``report --serve``."""

    def __init__(self, folder, *options, **environment):
        self.said = folder.parent / "served.txt"
        with self.said.open("w") as said:
            self.process = Fork(
                "report",
                "--serve",
                folder.name,
                *options,
                folder=folder.parent,
                stdout=said,
                env=environment,
            )
        wait_until(lambda: ADDRESS.search(self.said.read_text()), "the address", self.process)
        super().__init__(self.said.read_text())

    def end(self):
        """Exit code and errors after SIGINT."""
        self.process.send_signal(2)
        _, errors = self.process.communicate(DEADLINE)
        return self.process.returncode, errors
