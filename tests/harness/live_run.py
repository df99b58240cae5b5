"""A run with a live page, as the tests of the page and those of a browser ask it."""

import json
from pathlib import Path

from axis import write_study
from commands import Fork
from pages import Pages
from waiting import DEADLINE, count_in, wait_until


def page_processes(folder):
    """Processes that serve pages of the run in a folder."""
    found = []
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            command = path.read_bytes().split(b"\0")
            told = Path(path.parent, "fd", "1").readlink()
        except OSError:
            continue
        if b"bo_tuner.web" in command and told == folder / "log" / "web.log":
            found.append(int(path.parent.name))
    return found


class Page(Pages):
    """The page of a run that has said where it is.

    Parameters
    ----------
    process
        Of the run.
    said
        File that takes what it says.
    """

    def __init__(self, process, said):
        self.process, self.said = process, said
        super().__init__(said.read_text())

    def request(self, name, **headers):
        """Status and text of the answer to a request of the page, with some headers changed."""
        headers = self.origin | {"X-Control-Token": self.control_token()} | headers
        status, _, text = self.ask(
            f"/requests/{name}", method="POST", **{k: v for k, v in headers.items() if v}
        )
        return status, text

    def state_when(self, holds):
        """The parts of the page once a condition holds for what the server tells."""
        version, sections = -1, {}

        def told():
            nonlocal version
            status, _, text = self.ask(f"/state?after={version}")
            assert status == 200, text
            state = json.loads(text)
            assert state["version"] >= version
            version = state["version"]
            sections.update(state["sections"])
            return holds(state, sections)

        wait_until(told, "the state", self.process)
        return sections


class Run(Page):
    """A run with a page, held at an evaluation until it is let go."""

    def __init__(self, folder, study, hold, *options, **environment):
        write_study(folder, study)
        self.counter = folder / "cuts"
        file = folder / "said.txt"
        with file.open("w") as said:
            process = Fork(
                *("tune", "--backend", "inprocess", "--study", "axis.yaml", "--web", *options),
                folder=folder,
                env={"CUTS": str(self.counter), "HOLD": str(hold)} | environment,
                stderr=said,
            )
        wait_until(
            lambda: count_in(self.counter) == hold, "the evaluation", process, file.read_text
        )
        super().__init__(process, file)
        self.folder = folder / "runs" / "latest"
        self.name = self.folder.resolve().name

    def go_on(self):
        Path(f"{self.counter}.go").touch()

    def page_processes(self):
        return page_processes(self.folder.resolve())

    def finished(self):
        """Exit code of the run, once it has ended."""
        code = self.process.wait(DEADLINE)
        assert "Traceback" not in self.said.read_text()
        return code

    def end(self):
        self.process.terminate()
        self.go_on()
        self.process.communicate()
