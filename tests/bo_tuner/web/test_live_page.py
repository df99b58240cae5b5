"""The page of a run in progress, asked by an HTTP client: who may read it, what it shows, its end.

tests/browser has the same page as a reader sees it.
"""

import http.client
import json
import os
import re
import signal
import socket
from pathlib import Path

import pytest
from axis import write_axis
from commands import Fork, finish
from waiting import DEADLINE, count_in, wait_until

from bo_tuner.errors import OutputError
from bo_tuner.monitoring.status import RunStatus
from bo_tuner.optimizers.algorithms import ALGORITHMS
from bo_tuner.study.study_file import study_to_yaml
from bo_tuner.tuning.observer import Phase
from bo_tuner.web.address import listen
from bo_tuner.web.live_page import LivePage

ADDRESS = re.compile(r"live page: http://127\.0\.0\.1:(\d+)/\?token=([\w-]+)")


class Run:
    """A run with a page, held at an evaluation until it is let go."""

    def __init__(self, folder, study, hold, *options, **environment):
        write_axis(folder)
        (folder / "axis.yaml").write_text(study_to_yaml(study))
        self.counter = folder / "cuts"
        self.said = folder / "said.txt"
        with self.said.open("w") as said:
            self.process = Fork(
                *("tune", "--backend", "inprocess", "--study", "axis.yaml", "--web", *options),
                folder=folder,
                env={"CUTS": str(self.counter), "HOLD": str(hold)} | environment,
                stderr=said,
            )
        wait_until(
            lambda: count_in(self.counter) == hold, "the evaluation", self.process,
            self.said.read_text,
        )  # fmt: skip
        port, self.token = ADDRESS.search(self.said.read_text()).groups()
        self.port = int(port)
        self.folder = folder / "runs" / "latest"
        self.origin = {"Origin": f"http://127.0.0.1:{self.port}"}

    def ask(self, path, *, method="GET", token=True, **headers):
        """Status, headers and text of an answer."""
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=100.0)
        cookie = {"Cookie": f"bo_tuner_{self.port}={self.token}"} if token else {}
        connection.request(method, path, headers=cookie | headers)
        answer = connection.getresponse()
        text = answer.read().decode()
        connection.close()
        return answer.status, answer.headers, text

    def control_token(self):
        return re.search(r'data-token="([\w-]+)"', self.ask("/")[2]).group(1)

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

    def go_on(self):
        Path(f"{self.counter}.go").touch()

    def page_processes(self):
        """Processes that serve pages of this run."""
        found = []
        for path in Path("/proc").glob("[0-9]*/cmdline"):
            try:
                command = path.read_bytes().split(b"\0")
                told = Path(path.parent, "fd", "1").readlink()
            except OSError:
                continue
            if b"bo_tuner.web" in command and told == self.folder.resolve() / "log" / "web.log":
                found.append(int(path.parent.name))
        return found

    def finished(self):
        """Exit code of the run, once it has ended."""
        code = self.process.wait(DEADLINE)
        assert "Traceback" not in self.said.read_text()
        return code

    def end(self):
        self.go_on()
        if self.process.poll() is None:
            self.process.kill()
        self.process.communicate()


@pytest.fixture
def held(tmp_path, make_study):
    """Function that starts a run with a page, and waits until it is held at an evaluation."""
    runs = []

    def begin(hold=9, *options, **environment):
        runs.append(Run(tmp_path, make_study(), hold, *options, **environment))
        return runs[-1]

    yield begin
    for run in runs:
        run.end()


@pytest.fixture(scope="module")
def run(tmp_path_factory, make_study):
    """A run with a page, held at its ninth evaluation."""
    run = Run(tmp_path_factory.mktemp("web"), make_study(), 9)
    yield run
    run.end()


@pytest.fixture(scope="module")
def beside(tmp_path_factory, make_study):
    """A run in progress in a folder with a finished one and a broken one."""
    folder = tmp_path_factory.mktemp("beside")
    write_axis(folder)
    (folder / "axis.yaml").write_text(study_to_yaml(make_study()))
    arguments = ("tune", "--backend", "inprocess", "--study", "axis.yaml", "--quiet")
    code, _, err = finish(Fork(*arguments, folder=folder))
    assert code == 0, err
    (folder / "runs" / "broken").mkdir()
    (folder / "runs" / "broken" / "journal.sqlite").write_text("no journal")
    run = Run(folder, make_study(), 9)
    run.state_when(lambda state, made: "trials" in made)
    (run.finished_one,) = (
        path.name
        for path in (folder / "runs").iterdir()
        if (path / "best.yaml").exists() and not path.is_symlink()
    )
    run.name = run.folder.resolve().name
    yield run
    run.end()


class TestWhoMayRead:
    def test_the_token_becomes_a_cookie(self, run):
        status, headers, _ = run.ask(f"/?token={run.token}", token=False)
        assert (status, headers["Location"]) == (302, "/")
        cookie = headers["Set-Cookie"]
        assert cookie.startswith(f"bo_tuner_{run.port}={run.token};")
        assert "HttpOnly" in cookie
        assert "SameSite=Strict" in cookie
        status, headers, text = run.ask("/")
        assert status == 200
        assert headers["Content-Type"].startswith("text/html")
        # Neither page nor log tells it to the next reader.
        assert run.token not in text
        assert run.token not in (run.folder / "log" / "web.log").read_text()

    @pytest.mark.parametrize(
        "path", ["/", "/state?after=-1", "/trials/0", "/study.yaml", "/runs", "/compare"]
    )
    @pytest.mark.parametrize("query", ["", "token=", "token=wrong"])
    def test_others_are_refused(self, run, path, query):
        address = f"{path}{'&' if '?' in path else '?'}{query}"
        status, _, text = run.ask(address, token=False)
        assert status == 403
        assert len(text.splitlines()) == 1
        status, _, _ = run.ask(path, token=False, Cookie=f"bo_tuner_{run.port}=wrong")
        assert status == 403

    @pytest.mark.parametrize(
        "host", ["evil.example", "evil.example:{port}", "127.0.0.1.evil:{port}", "127.0.0.1:1"]
    )
    def test_other_host_names_are_refused(self, run, host):
        status, _, _ = run.ask("/", Host=host.format(port=run.port))
        assert status == 403

    def test_localhost_is_not_another(self, run):
        assert run.ask("/", Host=f"localhost:{run.port}")[0] == 200

    @pytest.mark.parametrize("name", ["pause", "continue", "abort"])
    def test_it_takes_no_requests_unless_allowed(self, run, name):
        assert "data-token" not in run.ask("/")[2]
        headers = run.origin | {"X-Control-Token": run.token}
        status, _, text = run.ask(f"/requests/{name}", method="POST", **headers)
        assert (status, text) == (
            403,
            "403: the page is read-only; tune --web-control allows requests\n",
        )

    @pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "PATCH", "OPTIONS"])
    def test_nothing_can_be_changed(self, run, method):
        before = (run.folder / "journal.sqlite").read_bytes()
        assert run.ask("/state?after=-1", method=method)[0] == 405
        assert (run.folder / "journal.sqlite").read_bytes() == before

    @pytest.mark.parametrize(
        "path", ["/study.yaml", "/../study.yaml", "/trials/99", "/trials/x", "//evil.example/"]
    )
    def test_what_is_not_there(self, run, path):
        status, _, text = run.ask(path)
        assert status == 404
        assert len(text.splitlines()) == 1

    def test_a_version_that_is_none(self, run):
        assert run.ask("/state?after=x")[0] == 400

    def test_every_answer_forbids_frames_and_sniffing(self, run):
        for path in ("/", "/state?after=-1", "/nothing"):
            _, headers, _ = run.ask(path)
            assert headers["Content-Security-Policy"] == "frame-ancestors 'none'"
            assert headers["X-Content-Type-Options"] == "nosniff"
            assert headers["Referrer-Policy"] == "no-referrer"
            assert headers["Cache-Control"] == "no-store"
            assert "Access-Control-Allow-Origin" not in headers

    def test_only_this_machine_reaches_it(self, run):
        # All addresses of 127.0.0.0/8 are this machine's, but only one is listened to.
        with pytest.raises(ConnectionRefusedError):
            socket.create_connection(("127.0.0.2", run.port), timeout=5.0)


class TestWhatItShows:
    def test_trials_and_then_the_result(self, held):
        # Evaluations 1 to 8 are those of trials 0 and 1.
        run = held(9)
        sections = run.state_when(lambda state, made: "trials" in made and "provenance" in made)
        assert "<caption" in sections["trials"]
        assert ">2 trials<" in sections["trials"]
        assert "No result yet: 2 of 5 trials" in sections["answer"]
        # Nobody shall resume a run that goes on.
        assert "tune --resume" not in sections["answer"]

        run.go_on()
        sections = run.state_when(lambda state, made: state["complete"])
        assert ">5 trials<" in sections["trials"]
        assert "kept all limits" in sections["answer"]
        assert run.finished() == 0
        assert run.page_processes() == []

    def test_the_present_state(self, held):
        run = held(8)
        found = []
        run.state_when(lambda state, _: state["now"].get("trials") == 2 and not found.append(state))
        now = found[-1]["now"]
        assert (now["phase"], now["done"], now["total"], now["trials"]) == ("tuning", 2, 5, 2)
        assert re.fullmatch(r"\d+:\d\d:\d\d", now["time_left"])
        # Names and values are told apart, also without the columns of a terminal.
        latest = now["texts"]["latest trial"]
        assert re.match(r"trial 1: gain \S+, error \S+, worst peak \S+, limit 1, ", latest)
        assert re.match(r"trial 2, (no|1) evaluation finished", now["texts"]["running"])

    def test_a_failure_with_its_reason_and_its_page(self, held):
        run = held(3, FAILING="1000")
        sections = run.state_when(lambda state, made: "failures" in made)
        assert "axis: stalled [/x] for good" in sections["failures"]
        status, _, page = run.ask("/trials/0")
        assert status == 200
        assert "Trial 0: failed" in page
        assert "axis: stalled [/x] for good" in page

    def test_json_lines_and_quiet_name_the_address_too(self, held):
        run = held(3, "--quiet")
        assert run.said.read_text().startswith("live page: http://127.0.0.1:")


class TestRequests:
    def test_only_the_page_itself_may_ask(self, held):
        run = held(6, "--web-control")
        refused = [
            {"Origin": ""},
            {"Origin": "null"},
            {"Origin": "http://evil.example"},
            {"Origin": f"https://127.0.0.1:{run.port}"},
            {"Origin": f"http://127.0.0.1:{run.port + 1}"},
            # The host is right, but the page was read under another name.
            {"Origin": f"http://localhost:{run.port}"},
            {"X-Control-Token": ""},
            {"X-Control-Token": "wrong"},
            {"X-Control-Token": run.token},
        ]
        for headers in refused:
            assert run.request("abort", **headers)[0] == 403, headers
        control = run.origin | {"X-Control-Token": run.control_token()}
        # Not even with the right token in the header, without the one in the cookie.
        assert run.ask("/requests/abort", method="POST", token=False, **control)[0] == 403
        assert run.ask("/requests/abort", **control)[0] == 405
        assert run.request("start")[0] == 405
        # Nothing of it has reached the run.
        run.go_on()
        assert run.finished() == 0

    def test_pause_and_continue(self, held):
        run = held(6, "--web-control")
        assert run.request("pause")[0] == 202
        asked = "the run pauses after the present evaluation"
        run.state_when(lambda state, _: state["now"]["texts"].get("asked") == asked)
        run.go_on()
        run.state_when(lambda state, _: state["now"]["paused"] and state["now"]["pausing"])
        done = count_in(run.counter)
        assert done == 6
        assert run.process.poll() is None
        assert run.request("continue")[0] == 202
        run.state_when(lambda state, _: state["complete"])
        assert run.finished() == 0

    def test_the_end_during_a_pause(self, held):
        run = held(6, "--web-control")
        run.request("pause")
        run.go_on()
        run.state_when(lambda state, _: state["now"]["paused"])
        assert run.request("abort")[0] == 202
        assert run.finished() == 143
        assert "interrupted by the live page; " in run.said.read_text().splitlines()[-1]
        assert run.page_processes() == []

    def test_they_need_a_page(self, tmp_path):
        code, out, err = finish(Fork("tune", "--web-control", folder=tmp_path))
        assert (code, out) == (2, "")
        assert "--web-control needs --web" in err


class TestOtherRuns:
    def test_they_are_listed_with_their_verdicts(self, beside):
        status, _, page = beside.ask("/runs")
        assert status == 200
        rows = re.findall(r'<input type="checkbox" name="run" value="([^"]+)"', page)
        assert rows == [beside.name, beside.finished_one]
        assert "kept all limits" in page
        assert re.search(r"No result yet: \d of 5 trials", page)
        assert "broken: " in page

    def test_the_report_of_one(self, beside):
        status, _, page = beside.ask(f"/runs/{beside.finished_one}")
        assert status == 200
        assert "kept all limits" in page
        # The server gives no files.
        assert "journal.sqlite" not in page

    def test_side_by_side(self, beside):
        status, _, page = beside.ask(f"/compare?run={beside.name}&run={beside.finished_one}")
        assert status == 200
        assert "2 runs side by side" in page
        assert "kept all limits" in page

    @pytest.mark.parametrize(
        ("query", "status"),
        [("", 400), ("run={0}", 400), ("run={0}&run={0}", 400), ("run={0}&run=none", 404),
         ("run={0}&run=..", 404), ("run={0}&run=broken", 409),
         ("&".join(f"run={k}" for k in range(9)), 400)],
    )  # fmt: skip
    def test_what_cannot_be_compared(self, beside, query, status):
        found, _, text = beside.ask(f"/compare?{query.format(beside.name)}")
        assert found == status
        assert len(text.splitlines()) == 1

    @pytest.mark.parametrize("name", ["none", "..", "%2e%2e", "..%2f..%2fetc", "latest"])
    def test_only_runs_in_the_folder_are_shown(self, beside, name):
        assert beside.ask(f"/runs/{name}")[0] == 404

    def test_a_run_is_read_again_once_it_has_changed(self, beside):
        before = beside.ask("/runs")[2]
        assert beside.ask("/runs")[2] == before
        path = beside.folder.parent / beside.finished_one / "summary.json"
        content = path.read_text()
        path.unlink()
        try:
            assert "kept all limits" not in beside.ask("/runs")[2]
        finally:
            path.write_text(content)


class TestEnd:
    @pytest.mark.parametrize(("signum", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
    def test_by_a_signal(self, held, signum, code):
        run = held(6)
        assert len(run.page_processes()) == 1
        run.process.send_signal(signum)
        run.go_on()
        assert run.finished() == code
        assert "interrupted by" in run.said.read_text().splitlines()[-1]
        assert run.page_processes() == []
        # The port is free again.
        with listen(run.port).socket:
            pass

    def test_of_a_run_that_is_killed(self, held):
        run = held(6)
        assert len(run.page_processes()) == 1
        run.process.kill()
        wait_until(lambda: run.page_processes() == [], "the end of the page")

    def test_of_the_page_leaves_the_run_alone(self, held):
        run = held(6)
        for pid in run.page_processes():
            os.kill(pid, signal.SIGKILL)
        run.go_on()
        assert run.finished() == 0
        assert run.said.read_text().count("the live page has ended") == 1


class TestAddress:
    def test_a_port_in_use(self, tmp_path, make_study):
        write_axis(tmp_path)
        (tmp_path / "axis.yaml").write_text(study_to_yaml(make_study()))
        with listen(0).socket as taken:
            port = taken.getsockname()[1]
            code, out, err = finish(
                Fork("tune", "--backend", "inprocess", "--study", "axis.yaml", "--web", port,
                      folder=tmp_path)
            )  # fmt: skip
        assert (code, out) == (2, "")
        assert err == (
            f"error: --web {port}: cannot listen on 127.0.0.1:{port}: Address already in use; "
            "expected a free port\n"
        )
        assert not (tmp_path / "runs").exists()

    def test_a_port_is_taken_by_one(self):
        with listen(0).socket as taken, pytest.raises(OutputError, match="expected a free port"):
            listen(taken.getsockname()[1])

    def test_no_two_tokens_are_alike(self):
        addresses = [listen(0) for _ in range(3)]
        for address in addresses:
            address.socket.close()
        assert len({address.token for address in addresses}) == 3
        # It is not shown by accident.
        assert all(address.token not in repr(address) for address in addresses)


def test_a_page_that_hangs_does_not_hold_the_run(tmp_path, make_study):
    study = make_study()
    status = RunStatus(study, ALGORITHMS["IV"])
    warnings = []
    with LivePage(study, tmp_path, status, listen(0), warnings.append) as page:
        (pid,) = [int(p.parent.name) for p in Path("/proc").glob("[0-9]*/fd")
                  if is_page_of(p.parent, tmp_path)]  # fmt: skip
        os.kill(pid, signal.SIGSTOP)
        status.begin(Phase.TUNING, 5)
        # Far more than a pipe holds.
        for _ in range(5000):
            page.advance()
        os.kill(pid, signal.SIGCONT)
    assert warnings == []


def is_page_of(process, folder):
    try:
        return (process / "fd" / "1").readlink() == folder / "log" / "web.log"
    except OSError:
        return False
